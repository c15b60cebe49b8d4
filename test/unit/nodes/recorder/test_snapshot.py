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


def test_messages_are_kept_for_their_time_and_not_longer() -> None:
    buffer, value = SnapshotBuffer(2.5), topic("/value", False)
    for received in (0, 1, 2_500_000_000):
        buffer.add(value, b"%d" % received, received, 0)
    assert len(buffer) == 3
    buffer.add(value, b"last", 2_500_000_001, 0)
    assert [kept.data for kept in buffer.take()] == [b"1", b"2500000000", b"last"]
    assert len(buffer) == 0 and buffer.take() == []


def test_the_last_latched_message_is_kept_however_old() -> None:
    """As if received with the first of the others, and before it."""
    buffer = SnapshotBuffer(1.0)
    robot, value = topic("/robot_description", True), topic("/value", False)
    for received, data in ((1, b"old"), (2, b"new")):
        buffer.add(robot, data, received, 7)
    for received in (5 * 10**9, 5 * 10**9 + 3):
        buffer.add(value, b"x", received, received)
    found = buffer.take()
    assert [(kept.data, kept.received, kept.sent) for kept in found] == [
        (b"new", 5 * 10**9, 7),
        (b"x", 5 * 10**9, 5 * 10**9),
        (b"x", 5 * 10**9 + 3, 5 * 10**9 + 3),
    ]
    assert [(kept.data, kept.received) for kept in buffer.take()] == [(b"new", 2)]


def test_messages_come_in_the_order_of_their_reception() -> None:
    buffer, value = SnapshotBuffer(10.0), topic("/value", False)
    for received in (5, 3, 4):
        buffer.add(value, b"x", received, 0)
    assert [kept.received for kept in buffer.take()] == [3, 4, 5]
