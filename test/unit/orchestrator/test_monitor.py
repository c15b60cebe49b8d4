# SPDX-License-Identifier: Apache-2.0
"""A monitor takes the newest diagnostics on demand, over DDS; they show what a run waits for."""

import io
from collections.abc import Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from tactile_hand_ros import names
from tactile_hand_ros.orchestrator.monitor import Monitor, View, line_console, missing_endpoints
from tactile_hand_ros.ros.diagnostics import ERROR, OK, STALE, WARN
from tactile_hand_ros.ros.processes import wait_until

SECOND = 10**9
PLANT, CONTROLLER, REGULATOR = (
    f"/left/{name}" for name in ("plant", "manipulation_controller", "slip_regulator")
)
MEMBERS = [names.PLANT, names.SENSOR, names.ORCHESTRATOR]
Facts = dict[str, dict[str, str]]


class Hand:
    """Publishes the messages of a hand's nodes."""

    def __init__(self, node: Node) -> None:
        self.node = node
        kinds = {"joint_command": JointState, "/diagnostics": DiagnosticArray}
        self._publishers = {
            topic: node.create_publisher(kind, topic, QoSProfile(depth=100))
            for topic, kind in kinds.items()
        }

    def monitor(self, *, closely: bool = False) -> Monitor:
        made = Monitor(self.node, closely=closely)
        for topic in ("/diagnostics", *(["joint_command"] if closely else [])):
            publisher = self._publishers[topic]
            wait_until(lambda p=publisher: p.get_subscription_count() == 1, message=topic)
        return made

    def send(self, topic: str, message: Any) -> None:
        publisher = self._publishers[topic]
        publisher.publish(message)
        assert publisher.wait_for_all_acked()

    def report(self, name: str, level: bytes = OK, message: str = "", **values: object) -> None:
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
        self.send("/diagnostics", DiagnosticArray(status=[status]))


@pytest.fixture
def hand(context: Any) -> Iterator[Hand]:
    node = Node("hand", context=context, namespace="/left", start_parameter_services=False)
    yield Hand(node)
    node.destroy_node()


def test_what_the_nodes_say_is_kept_by_node_until_they_say_something_else(hand):
    monitor = hand.monitor()
    assert monitor.facts() == {} and monitor.faults() == [] and monitor.tick == -1
    assert monitor.answered() == -1 and not monitor.is_at_rest
    assert monitor.in_words() == "pose error unknown  k_f -"
    hand.report(PLANT, answered_ns=3 * SECOND, tick_ns=4 * SECOND, mode="a")
    hand.report(REGULATOR, WARN, "at its limit", grasp_force_n=7.125)
    hand.report(CONTROLLER, ERROR, "no contact", position_error_m=0.0123, mode="drive")
    hand.report("/left/viewer", STALE, "silent")
    for other in ("/right/plant", "/left/thumb/plant", "/plant"):
        hand.report(other, ERROR, "of another hand", answered_ns=9 * SECOND)
    assert monitor.in_words() == "pose error 12.300 mm  k_f 7.12 N"
    assert monitor.answered() == monitor.tick == 3 * SECOND
    assert monitor.of("plant")["mode"] == "a"
    assert monitor.faults() == [f"{CONTROLLER}: no contact", f"{REGULATOR}: at its limit"]
    hand.report(CONTROLLER, position_error_m=0.1, mode="hold")  # the last error is stale
    assert monitor.faults() == [f"{REGULATOR}: at its limit"]
    assert monitor.in_words() == "not driving: hold  k_f 7.12 N"


@pytest.mark.parametrize(
    ("mode", "answered", "rests"),
    [("paused", 4, True), ("finished", 4, True), ("running", 4, False), ("paused", 3, False)],
)
def test_the_plant_rests_when_it_stands_still_and_its_tick_is_answered(hand, mode, answered, rests):
    monitor = hand.monitor()
    hand.report(PLANT, mode=mode, tick_ns=4, answered_ns=answered)
    assert monitor.is_at_rest == rests


def test_only_from_close_by_each_command_is_seen(hand):
    hand.monitor()
    assert {each.topic_name for each in hand.node.subscriptions} == {"/diagnostics"}
    for each in list(hand.node.subscriptions):
        hand.node.destroy_subscription(each)
    monitor = hand.monitor(closely=True)
    assert monitor.answered() == -1
    for second in (2, 2, 1, 7):
        message = JointState()
        message.header.stamp = Time(seconds=second).to_msg()
        hand.send("joint_command", message)
        assert monitor.answered() == monitor.tick == second * SECOND


@pytest.mark.parametrize(("duration", "of"), [(5.5, " of 5.5"), (None, "")])
def test_progress_is_a_line_now_and_then_and_a_fault_is_printed_once_in_full(hand, duration, of):
    monitor, text, fault = hand.monitor(), io.StringIO(), "[b] " + "why " * 100
    hand.report(PLANT, WARN, fault, answered_ns=1.25 * SECOND)
    monitor.tick = 1_250_000_000
    where = line_console(text, width=80)
    View(where, duration, quiet=True).show(monitor)
    assert text.getvalue() == ""
    view = View(where, duration, quiet=False)
    view.show(monitor)
    view.show(monitor)
    line = f"t = 1.25{of} s  {monitor.in_words()}\n"
    assert text.getvalue() == f"t = 1.25 s  ! {PLANT}: {fault}\n" + 2 * line
    assert view.period == 2.0


def all_matched(*, recorder: bool = False) -> Facts:
    """Return the reports of fully matched nodes: two topics, and commands of a user."""
    contacts, clock, pose = (f"/left/{t}" for t in ("contacts", "clock", names.DESIRED_POSE))
    facts = {
        names.PLANT: {
            f"publications {contacts}": 1 + recorder,
            f"publications {clock}": int(recorder),
            f"subscriptions {pose}": 1,
            "publications /diagnostics": 0,
            "mode": "paused",
        },
        names.SENSOR: {f"subscriptions {contacts}": 1},
        names.ORCHESTRATOR: {f"publications {pose}": 1},
    }
    if recorder:
        facts[names.RECORDER] = {f"subscriptions {contacts}": 1, f"subscriptions {clock}": 1}
    return {
        f"/left/{name}": {key: str(value) for key, value in values.items()}
        for name, values in facts.items()
    }


def missing(hand: Hand, facts: Facts, members: list[str] = MEMBERS) -> list[tuple[str, str]]:
    return list(missing_endpoints(hand.node, members, facts))


def test_a_recorder_receives_every_topic_but_the_commands_of_users(hand):
    """One in the process of the nodes is not waited for."""
    facts, members = all_matched(recorder=True), [*MEMBERS, names.RECORDER]
    assert missing(hand, facts, members) == []
    facts[f"/left/{names.RECORDER}"] = {}
    told = [text for name, text in missing(hand, facts, members) if name == names.RECORDER]
    assert told == [f"recorder does not receive /left/{t} yet" for t in ("contacts", "clock")]
    facts = all_matched()
    facts[f"/left/{names.RECORDER}"] = {"subscriptions /left/clock": "1"}
    assert missing(hand, facts) == []


def test_a_node_that_has_not_matched_is_named(hand):
    facts, topic = all_matched(), "/left/contacts"
    facts[f"/left/{names.PLANT}"][f"publications {topic}"] = "0"
    facts[f"/left/{names.SENSOR}"][f"subscriptions {topic}"] = "0"
    assert missing(hand, facts) == [
        (names.SENSOR, f"{names.SENSOR} does not receive {topic} yet"),
        (names.PLANT, f"{names.PLANT} has matched 0 of 1 subscribers of {topic}"),
    ]


@pytest.mark.parametrize("absent", MEMBERS)
def test_a_node_that_has_not_reported_is_missing(hand, absent):
    facts = all_matched()
    del facts[f"/left/{absent}"]
    assert (absent, f"{absent} does not report yet") in missing(hand, facts)


def test_a_subscriber_from_outside_must_be_matched_too(hand, context):
    viewer = Node("viewer", context=context, namespace="/left")
    viewer.create_subscription(Empty, names.CLOCK, print, 1)
    topic = "/left/clock"
    wait_until(lambda: hand.node.count_subscribers(topic) == 1)
    expected = (names.PLANT, f"plant has matched 0 of 1 subscribers of {topic}")
    assert missing(hand, all_matched()) == [expected]
    viewer.destroy_node()
