# SPDX-License-Identifier: Apache-2.0
"""A running hand is steered from other processes: no command is lost, refusals are answered."""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from support.messages import pose_message

from bench.processes import CapturedProcess, start_executable
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.cli.app import main
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify.recompute import recompute

PATIENCE = 120.0
POSES = [(0.0, 0.0436, 0.4098 + 1e-4 * i) for i in range(8)]


@pytest.fixture
def hand(domain: int, tmp_path: Path) -> Iterator[tuple[CapturedProcess, float]]:
    """Return an orchestrator with a hand that runs until a signal, and when it was started, s."""
    began = time.monotonic()
    words = ("paper", "--interactive", "--out", str(tmp_path / "runs"), "--set", "targets=[]")
    words += ("--set", "plant.command_timeout=60")  # a slow computer must not count as silence
    with start_executable("orchestrator", *words) as process:
        process.wait_for_output("t = ", PATIENCE)
        yield process, began


def publish_once(domain: int, position: tuple[float, float, float]) -> None:
    """Publish as `ros2 topic pub --once` does: to the first subscriber, and leave soon after."""
    with ros_context(domain=domain) as context:
        node = Node("once", context=context)
        publisher = node.create_publisher(PoseStamped, "desired_pose", 1)
        wait_until(lambda: publisher.get_subscription_count() >= 1, PATIENCE)
        publisher.publish(pose_message(position, np.eye(3), 0))
        publisher.wait_for_all_acked()
        node.destroy_node()


def test_every_pose_arrives_and_refusals_are_answered(hand, domain, tmp_path, capsys):
    """Poses of publishers that leave at once, then commands; a second run is refused meanwhile."""
    with start_executable("orchestrator", "paper", "--out", str(tmp_path / "runs")) as second:
        assert second.wait(PATIENCE) == 2 and "a run is in progress" in second.stderr
    assert len(list((tmp_path / "runs").iterdir())) == 2  # the first run, and the link to it
    for position in POSES:
        publish_once(domain, position)
    wait = ["--timeout", "60"]
    assert main(["move", "0.0", "0.0436", "0.4118", "--rotation", "0", "0", "-3", *wait]) == 0
    said = capsys.readouterr().out
    assert "the target is (0, 0.0436, 0.4118) m, rotation (0, 0, -3) degrees" in said
    assert main(["move", "0.0", "-0.5", "0.4", *wait]) == 2
    assert "the hand rejects the command: desired pose" in capsys.readouterr().err
    assert main(["squeeze", "12", *wait]) == 0
    assert main(["squeeze", "1000", *wait]) == 2
    assert "is outside" in capsys.readouterr().err
    orchestrator, began = hand
    earlier = time.monotonic() - began
    for command in ("release", "grasp", "reset"):
        assert main([command, *wait]) == 0
    assert main(["move", "0.0", "0.0436", "0.4108", *wait]) == 0
    orchestrator.send(signal.SIGINT)
    assert orchestrator.wait(PATIENCE) == 0, orchestrator.stderr
    run = Run(tmp_path / "runs" / "latest")
    summary = json.loads((run.folder / "summary.json").read_text())
    assert 0.0 < summary["start_to_first_tick_s"] < earlier  # of the run, not of the reset
    points = [m.message.pose.position for m in read_messages(run.bag, ["/accepted/desired_pose"])]
    commanded = [(0.0, 0.0436, 0.4118), (0.0, 0.0436, 0.4108)]
    # One that comes together with a reset is taken on both sides of it.
    assert list(dict.fromkeys((p.x, p.y, p.z) for p in points)) == [*POSES, *commanded]
    assert "/desired_pose" not in summarize(run.bag).types
    assert run.record.desired_position[-1].tolist() == [0.0, 0.0436, 0.4108]
    assert all(each.same for each in recompute(run)) and run.bag_metrics.complete
