# SPDX-License-Identifier: Apache-2.0
"""A monitor takes the newest messages of a hand, over real DDS in this process, when asked."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rich.console import Console
from sensor_msgs.msg import JointState
from support.messages import pose_message

from tactile_hand_ros.orchestrator import monitor as module
from tactile_hand_ros.orchestrator.monitor import Monitor, Progress, Rate, View, facts
from tactile_hand_ros.ros.diagnostics import ERROR, OK, STALE, WARN
from tactile_hand_ros.ros.messages import stamp_from_ns
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import TargetConfig

SECOND = 10**9
STRAIGHT = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class Hand:
    """Publishes what the nodes of a hand would publish."""

    def __init__(self, node: Node) -> None:
        self.node = node
        kinds = {
            "joint_command": JointState,
            "auxiliary_pose": PoseStamped,
            "/diagnostics": DiagnosticArray,
        }
        self._publishers = {
            topic: node.create_publisher(kind, topic, QoSProfile(depth=100))
            for topic, kind in kinds.items()
        }

    def meets(self, *topics: str) -> None:
        for topic in topics:
            publisher = self._publishers[topic]
            wait_until(lambda p=publisher: p.get_subscription_count() == 1, message=topic)

    def send(self, topic: str, message: Any) -> None:
        publisher = self._publishers[topic]
        publisher.publish(message)
        assert publisher.wait_for_all_acked()

    def report(self, name: str, level: bytes, message: str = "", **values: object) -> None:
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
        self.send("/diagnostics", DiagnosticArray(status=[status]))

    def answer(self, stamp: int) -> None:
        message = JointState()
        message.header.stamp = stamp_from_ns(stamp)
        self.send("joint_command", message)

    def pose(self, topic: str, x: float, stamp: int) -> None:
        self.send(topic, pose_message([x, 0.2, 0.3], STRAIGHT, stamp))


@pytest.fixture
def hand() -> Iterator[Hand]:
    with isolated_domain() as domain, private_context(domain) as context:
        node = Node("hand", context=context, namespace="/left", start_parameter_services=False)
        yield Hand(node)
        node.destroy_node()


def test_what_the_nodes_say_is_kept_by_node_until_they_say_something_else(hand: Hand) -> None:
    monitor = Monitor(hand.node, [], closely=False)
    hand.meets("/diagnostics")
    assert monitor.facts() == {} and monitor.faults() == [] and monitor.tick == -1
    assert monitor.answered() == -1 and not monitor.is_at_rest
    blank = monitor.progress()
    assert blank.time == 0.0 and math.isnan(blank.position_error) and math.isnan(blank.grasp_force)
    hand.report("/left/plant", OK, "running", answered_ns=3 * SECOND, tick_ns=4 * SECOND, mode="a")
    hand.report("/left/slip_regulator", WARN, "at its limit", grasp_force_n=7.5)
    hand.report(
        "/left/manipulation_controller", ERROR, "no contact", position_error_m=0.25, mode="drive"
    )
    hand.report("/right/plant", STALE, "silent", answered_ns=9 * SECOND)
    assert monitor.progress() == Progress(3.0, 0.25, 7.5, "drive")
    assert monitor.tick == 3 * SECOND
    assert monitor.plant_facts()["mode"] == "a"
    assert monitor.faults() == [
        "/left/manipulation_controller: no contact",
        "/left/slip_regulator: at its limit",
    ]
    hand.report("/left/manipulation_controller", OK)
    assert monitor.faults() == ["/left/slip_regulator: at its limit"]
    assert math.isnan(monitor.progress().position_error)


@pytest.mark.parametrize(
    ("mode", "answered", "rests"),
    [
        ("paused", 4, True),
        ("finished", 4, True),
        ("running", 4, False),
        ("holding", 4, False),
        ("paused", 3, False),
    ],
)
def test_the_plant_rests_when_it_stands_still_and_its_tick_is_answered(
    hand: Hand, mode: str, answered: int, rests: bool
) -> None:
    monitor = Monitor(hand.node, [], closely=False)
    hand.meets("/diagnostics")
    hand.report("/left/plant", OK, mode=mode, tick_ns=4, answered_ns=answered)
    assert monitor.is_at_rest == rests


def test_from_close_by_the_error_is_that_from_the_target_of_the_tick(hand: Hand) -> None:
    targets = [
        TargetConfig(position=(5.0, 0.2, 0.3), time=3.0),
        TargetConfig(position=(2.0, 0.2, 0.3), time=4.0),
    ]
    monitor = Monitor(hand.node, targets, closely=True)
    hand.meets("joint_command", "auxiliary_pose", "/diagnostics")
    assert monitor.answered() == -1 and math.isnan(monitor.progress().position_error)
    for x, second, error in ((1.0, 2, math.nan), (1.5, 3, 3.5), (1.5, 5, 0.5)):
        hand.pose("auxiliary_pose", x, second * SECOND)
        for _ in range(2):  # also without a newer pose
            found = monitor.progress().position_error
            assert found == error or math.isnan(found) and math.isnan(error)
    for second in (2, 2, 1, 7):
        hand.answer(second * SECOND)
        assert monitor.answered() == second * SECOND == monitor.tick
        assert monitor.progress().time == second


def test_from_afar_nothing_of_a_tick_is_subscribed_to(hand: Hand) -> None:
    def topics() -> set[str]:
        return {each.topic_name for each in hand.node.subscriptions}

    Monitor(hand.node, [], closely=False)
    assert topics() == {"/diagnostics"}
    Monitor(hand.node, [], closely=True)
    assert topics() == {"/diagnostics", "/left/joint_command", "/left/auxiliary_pose"}


NOW = Progress(time=1.25, position_error=0.0123, grasp_force=7.125)


def console(**options: Any) -> Console:
    return Console(file=io.StringIO(), width=120, **options)


def written(where: Console) -> str:
    assert isinstance(where.file, io.StringIO)
    return where.file.getvalue()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0, "0.000 mm"),
        (0.0099994, "9.999 mm"),
        (0.01, "10.0 mm"),
        (0.0123, "12.3 mm"),
        (math.nan, "unknown"),
    ],
)
def test_an_error_below_a_centimetre_is_shown_to_the_micrometre(error: float, words: str) -> None:
    shown = facts(Progress(0.0, error, 7.125), 499.6)
    assert shown == f"pose error {words}  k_f 7.12 N  500 ticks/s"


def test_a_force_that_is_not_known_is_a_dash() -> None:
    assert facts(Progress(0.0, 0.0, math.nan), 0.0) == "pose error 0.000 mm  k_f -  0 ticks/s"


def test_an_error_is_shown_only_while_the_hand_drives() -> None:
    """After a drop the last error would stay on the screen."""
    held, driven = (facts(Progress(0.0, 0.1, 7.0, mode), 1.0) for mode in ("hold", "drive"))
    assert held == "not driving: hold  k_f 7.00 N  1 ticks/s"
    assert driven == "pose error 100.0 mm  k_f 7.00 N  1 ticks/s"


@pytest.mark.parametrize(
    ("duration", "fault", "line"),
    [
        (5.5, "", f"t = 1.25 of 5.5 s  {facts(NOW, 250.0)}\n"),
        (None, "[b] is stale", f"t = 1.25 s  {facts(NOW, 250.0)}  ! [b] is stale\n"),
        (None, "x" * 400, f"t = 1.25 s  {facts(NOW, 250.0)}  ! {'x' * 400}\n"),
    ],
)
def test_a_pipe_gets_a_line_now_and_then(duration: float | None, fault: str, line: str) -> None:
    where = console(force_terminal=False)
    view = View(where, duration, quiet=False)
    with view.shown():
        view.show(NOW, 250.0, fault)
    assert written(where) == line and view.period == 2.0


def test_a_bar_is_gone_at_the_end_and_a_fault_is_printed_in_full_above_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    where = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    view = View(where, 5.0, quiet=False)
    assert view.period == 0.1
    reason = f"[plant] {'why ' * 30}end"
    with view.shown():
        before = len(written(where))
        view.show(NOW, 250.0, reason)
        view.show(NOW, 250.0, reason)
        drawn = written(where)[before:]
    assert "  1.25 / 5 s" in drawn and facts(NOW, 250.0) in drawn
    assert drawn.count(reason) == 1  # a fault that stays is printed once
    assert written(where).endswith("\x1b[2K")


def test_quiet_means_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    where = console(force_terminal=True)
    quiet = View(where, 1.0, quiet=True)
    with quiet.shown():
        quiet.show(NOW, 250.0, "a fault")
    assert quiet.period == math.inf and written(where) == ""
    monkeypatch.setenv("TERM", "dumb")
    assert View(console(force_terminal=True), 1.0, quiet=False).period == 2.0


def test_the_rate_is_that_between_two_stamps_that_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    rate = Rate(2_000_000)
    assert rate(2_000_000) == 0.0  # the first: since when is not known
    now += 0.5
    assert rate(2_000_000) == 0.0
    assert rate(202_000_000) == 200.0
    now += 0.25
    assert rate(202_000_000) == 200.0  # nothing new
    now += 0.25
    assert rate(302_000_000) == 100.0
    assert rate(402_000_000) == 100.0  # no time has passed
