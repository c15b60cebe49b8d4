# SPDX-License-Identifier: Apache-2.0
"""What a snapshot holds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from tactile_hand_ros.nodes.recorder.snapshot import SnapshotBuffer


def topic(name: str, latched: bool) -> Any:
    """Return what the buffer asks of a topic."""
    return SimpleNamespace(name=name, latched=latched)


def test_latched_message_is_in_every_snapshot() -> None:
    """A reader of the second snapshot alone still learns the robot."""
    buffer = SnapshotBuffer(10.0)
    robot, value = topic("/robot_description", True), topic("/value", False)
    buffer.add(robot, b"robot", 1, 1)
    buffer.add(value, b"1", 2, 2)
    assert [kept.data for kept in buffer.take()] == [b"robot", b"1"]
    buffer.add(value, b"2", 5, 5)
    assert [(kept.data, kept.received) for kept in buffer.take()] == [(b"robot", 5), (b"2", 5)]
