# SPDX-License-Identifier: Apache-2.0
"""Replay as a process of its own, over real DDS; test/unit/nodes/test_replay.py has the rest."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from std_srvs.srv import SetBool
from support.nodes import process

from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.cli.app import main
from tactile_hand_ros.ros.middleware import isolated_domain
from tactile_hand_ros.ros.processes import CapturedProcess

DEEP = QoSProfile(depth=1000)
COUNT = 200
BEGIN, SPACING = 10**18, 5_000_000  # ns


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of a second."""
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        values = writer.add_channel("/value", "std_msgs/msg/Float64")
        for i in range(COUNT):
            data = serialize_message(Float64(data=float(i)))
            writer.write(values, data, BEGIN + i * SPACING, 0)
    return folder


def test_pause_and_interrupt(bag: Path) -> None:
    """Nothing is published while paused; Ctrl-C ends without a traceback."""
    command = [sys.executable, "-m", "tactile_hand_ros.cli", "replay", bag, "--start-paused"]
    options = ["--topics=/value"]
    with process() as here, CapturedProcess([*command, *options]) as replay:
        here.receive(Float64, "/value", DEEP)
        assert here.call(SetBool, "/replay/pause", data=False).success
        here.messages("/value", 21)
        assert here.call(SetBool, "/replay/pause", data=True).success
        paused_at = len(here.messages("/value", 21))
        for _ in range(20):  # each takes longer than the next message would
            here.call(SetBool, "/replay/pause", data=True)
        assert len(here.messages("/value", 21)) - paused_at <= 1 and paused_at < COUNT
        here.call(SetBool, "/replay/pause", data=False)
        found = [message.data for message in here.messages("/value", paused_at + 21)]
        assert found == [float(i) for i in range(len(found))]
        replay.send(signal.SIGINT)
        assert replay.wait() == 130 and "Traceback" not in replay.stderr


@pytest.mark.parametrize(
    ("argument", "text"),
    [
        ("--rate=0", "expected a number above 0"),
        ("--exclude=(", "not a valid regular expression"),
        ("--set=a=1", "expected --recompute too"),
        ("--start-offset=nan", "offset"),
        ("--namespace=1x", "the namespace is '1x'"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(
    bag: Path, capsys: pytest.CaptureFixture[str], argument: str, text: str
) -> None:
    with isolated_domain():
        assert main(["replay", str(bag), "--start-paused", argument]) == 2
    printed = capsys.readouterr().err
    assert text in printed and printed.count("\n") == 1
