# SPDX-License-Identifier: Apache-2.0
"""What regulator, optimizer and controller publish after ticks, services, commands, parameters."""

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, JoyFeedbackArray
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import SetBool, Trigger
from support.messages import pose_message, stamp_to_ns
from support.nodes import counts, facts, tapped

from tactile_hand_ros import names
from tactile_hand_ros.control import controller, holds, sensing
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.targets import MAX_WAITING
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.nodes.force_optimizer import ForceOptimizerNode
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import OK, WARN
from tactile_hand_ros.ros.endpoints import TickFailedError
from tactile_hand_ros.ros.messages import JointCodec, WrenchCodec
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

TICK, DAY = 2_000_000, 86_400_000_000_000  # ns
PLANT = Plant(load_scenario("paper").plant)
STATE, HAND = PLANT.state, PLANT.hand
JOINTS = Joints(STATE.theta, STATE.rates, STATE.joints.applied)
FRACTIONS = np.tile([0.0, 1.0 / 3.0, 0.0], (3, 1))
PUSH = np.array([[0.3, 2.0, -0.1], [0.1, 3.0, 0.2], [-0.2, 2.5, 0.4]])
FRICTION = np.array([0.5, 0.6, 0.7])
CENTRE = STATE.contacts.positions.mean(axis=0)
ODD = Contacts(STATE.contacts.positions + 0.5, STATE.contacts.rotations)
ALL = [SlipRegulatorNode, ForceOptimizerNode, ManipulationControllerNode]


def level(node: Any) -> tuple[bytes, str]:
    status = node.diagnostics.status()
    return status.level, status.message


def tick(node: Any, stamp: int, forces: Any = PUSH, **changes: Any) -> Any:
    """Let a node answer a tick, with the inputs of the paper's grasp or changed ones."""
    if isinstance(node, SlipRegulatorNode):
        return node.step(stamp, JOINTS, STATE.contacts, forces)
    if isinstance(node, ForceOptimizerNode):
        return node.step(stamp, changes.get("contacts", STATE.contacts), FRICTION, forces)
    shape = changes.get("shape", FRACTIONS)
    contacts = changes.get("contacts", STATE.contacts)
    touch = contacts, shape, changes.get("grasp_force", 10.0)
    return node.step(stamp, JOINTS, *touch)


def asked(messages: list[Any]) -> list[tuple[str, str, int]]:
    """Return name, value and timestamp of requests."""
    found = [(message.status[0], stamp_to_ns(message.header.stamp)) for message in messages]
    return [(status.message, status.values[0].value, stamp) for status, stamp in found]


def torque(sent: dict[str, list[bytes]], at: int = -1) -> tuple[int, Any]:
    stamp, (values,) = JointCodec(HAND.joint_names, ("effort",)).decode(sent["joint_command"][at])
    return stamp, values


@pytest.mark.parametrize("kind", ALL)
def test_an_answer_is_published_with_its_tick_and_repeated_to_the_byte(here, kind):
    node = here.make(kind)
    kinds = {each.topic.lstrip("/"): each.kind for each in node.tick_publishers}
    sent = tapped(node)
    node.on_repeat()
    assert not any(sent.values()) and facts(node)["ticks"] == "0"
    tick(node, TICK)
    before = {topic: list(messages) for topic, messages in sent.items()}
    node.on_repeat()
    for topic, messages in sent.items():
        stamp = deserialize_message(before[topic][0], kinds[topic]).header.stamp
        assert stamp_to_ns(stamp) == TICK and len(before[topic]) == 1
        repeats = [] if topic == names.AUXILIARY_POSE else before[topic]
        assert messages == before[topic] + repeats
    assert facts(node)["ticks"] == "1" and "latency_max_us" in facts(node)


@pytest.mark.parametrize("kind", ALL)
def test_ticks_that_start_over_find_nothing_of_before(here, kind):
    node = here.make(kind)
    sent = tapped(node)
    tick(node, 0)
    first = {topic: messages[-1] for topic, messages in sent.items()}
    for stamp in range(1, 20):
        tick(node, stamp * TICK, 2.0 * PUSH[::-1])
    node.on_restart()
    tick(node, 0)
    assert {topic: messages[-1] for topic, messages in sent.items()} == first


@pytest.mark.parametrize(
    ("kind", "name", "value", "key"),
    [
        (SlipRegulatorNode, "maximum", 33.0, names.REGULATOR),
        (ForceOptimizerNode, "minimum_normal", 0.2, names.OPTIMIZER),
        (ManipulationControllerNode, "law.k_p", 77.0, names.CONTROLLER),
    ],
)
def test_a_changed_parameter_is_published_with_its_first_tick(here, kind, name, value, key):
    node = here.make(kind)
    topic = names.accepted_parameters(key)
    here.receive(ParameterEvent, topic, qos.latched_qos(qos.USER_DEPTH))
    for stamp in range(4):
        if stamp == 2:
            assert node.set_parameters([Parameter(name, value=value)])[0].successful
        tick(node, stamp * TICK)
    node.on_restart()
    tick(node, 0)
    events = here.messages(topic, 3)
    assert [stamp_to_ns(event.stamp) for event in events] == [0, 2 * TICK, 0]
    changed = [{p.name: p.value.double_value for p in e.changed_parameters} for e in events]
    assert changed[0][name] != changed[1][name] == changed[2][name] == value


def test_k_f_follows_the_user_and_goes_back_with_a_reset(here):
    node = here.make(SlipRegulatorNode, grasp_force=10.0, mode="user", maximum=40.0)
    sent = tapped(node)
    here.receive(WrenchStamped, names.ACCEPTED_FORCE)
    requests = names.accepted_requests(names.REGULATOR)
    here.receive(DiagnosticArray, requests)
    assert tick(node, 0) == 10.0
    here.send(names.USER_GRASP_FORCE, Float64(data=12.0))
    stamps = iter(range(TICK, 10_000 * TICK, TICK))
    here.wait(lambda: tick(node, next(stamps)) > 10.0)
    (accepted,) = here.messages(names.ACCEPTED_FORCE, 1)
    last = next(stamps)
    assert stamp_to_ns(accepted.header.stamp) in (last - TICK, last - 2 * TICK)
    assert accepted.wrench.force.y == 12.0
    answer = here.call(Trigger, "slip_regulator/reset")
    assert (answer.success, answer.message) == (True, "k_f = 10 N")
    assert tick(node, last) == 10.0
    assert asked(here.messages(requests, 1)) == [("reset", "", last)]
    _, force = WrenchCodec(names.PALM_FRAME).decode(sent["grasp_force"][-1])
    assert list(force) == [0.0, 10.0, 0.0]
    grip = deserialize_message(sent["grip_state"][-1], JointState)
    assert list(grip.name) == ["finger_1", "finger_2", "finger_3"]


def test_what_a_user_asks_in_vain_is_answered_with_the_last_tick_and_no_flood(here):
    node, topic = here.make(SlipRegulatorNode), names.rejected(names.REGULATOR)
    here.receive(DiagnosticArray, topic)
    here.wait(lambda: node.peers()[f"publications /{topic}"] == 1, "the match")
    node.reject(names.CONTACTS, "no command of a user")
    tick(node, TICK)
    for number in range(12):
        node.reject(names.CONTACTS, "no command of a user")
        node.reject(names.USER_GRASP_FORCE, str(number))
    here.messages(topic, 10)
    tick(node, 2 * TICK)
    here.send(names.USER_GRASP_FORCE, Float64(data=-3.0))
    *known, last = here.messages(topic, 11)
    expected = [(str(number), str(number), TICK) for number in range(10)]
    assert asked(known) == expected
    (status,) = last.status
    assert (status.level, status.name) == (WARN, names.REGULATOR)
    assert status.values[0].key == names.USER_GRASP_FORCE and "-3.0" in status.message
    assert stamp_to_ns(last.header.stamp) == 2 * TICK


def test_the_haptic_device_gets_levels_every_20_ms_of_the_ticks(here):
    node = here.make(SlipRegulatorNode, grasp_force=10.0, maximum=40.0, mode="user")
    here.receive(JoyFeedbackArray, names.HAPTIC_FEEDBACK)
    for stamp in (0, 10_000_000, 19_999_999, 20_000_000, 39_000_000, 40_000_000):
        tick(node, stamp)
    levels = [m.array[0].intensity for m in here.messages(names.HAPTIC_FEEDBACK, 3)]
    assert levels == [0.25, 0.25, 0.25]


@pytest.mark.parametrize("force", [-1e-9, 40.0001, np.nan, np.inf])
def test_no_k_f_beyond_its_limits_is_published(here, force, monkeypatch):
    core = "tactile_hand_ros.control.slip.regulator.SlipRegulator.step"
    monkeypatch.setattr(core, lambda *_: 10.0)
    node = here.make(SlipRegulatorNode, maximum=40.0)
    sent = tapped(node)
    monkeypatch.setattr(core, lambda *_: force)
    with pytest.raises(TickFailedError, match="is outside 0 to 40.0 N"):
        tick(node, 0)
    assert not any(sent.values()) and counts(node, "errors") == {"ticks": 1}


def test_a_late_regulator_uses_the_ticks_that_it_does_not_answer(here):
    whole, late = here.make(SlipRegulatorNode), here.make(SlipRegulatorNode)
    sent, forces = tapped(late), [PUSH * (1.0 + 0.1 * np.sin(row)) for row in range(30)]
    for row, force in enumerate(forces):
        expected = tick(whole, row * TICK, force)
        if row % 3 == 2:
            assert tick(late, row * TICK, force) == expected
        else:
            late.observe(row * TICK, STATE.contacts, force, JOINTS)
    assert len(sent["grasp_force"]) == 10


def test_that_touch_is_rejected_is_noted_once_and_stays_when_ticks_start_over(here):
    node = here.make(SlipRegulatorNode)
    topic = names.accepted_requests(node.get_name())
    here.receive(DiagnosticArray, topic)
    for stamp, rejected in enumerate(np.array([[0, 0, 0], [0, 1, 1], [0, 1, 1]], dtype=bool)):
        node.reject_touch(rejected)
        tick(node, stamp)
    node.on_restart()
    tick(node, 0)
    node.reject_touch(np.zeros(3, dtype=bool))
    tick(node, 5)
    told = names.TOUCH_REJECTED
    expected = [(told, "finger_2, finger_3", at) for at in (1, 0)] + [(told, "", 5)]
    assert asked(here.messages(topic, 3)) == expected


def test_the_rejected_fingers_are_read_by_name_and_unknown_ones_refused(here):
    node = here.make(SlipRegulatorNode, composed=False)
    topic, asking = names.TOUCH_REJECTED, names.accepted_requests(node.get_name())
    here.receive(DiagnosticArray, asking)
    here.send(topic, String(data="finger_3, finger_1"), qos.latched_qos())
    stamps = iter(range(0, 10_000 * TICK, TICK))
    here.wait(lambda: tick(node, next(stamps)) and here.messages(asking, 0))
    assert asked(here.messages(asking, 1))[0][:2] == (topic, "finger_1, finger_3")
    for data in ("thumb", "finger_1,finger_2"):
        here.send(topic, String(data=data), qos.latched_qos())
    here.wait(lambda: counts(node, "rejected").get(topic) == 2)


def test_without_an_answer_f_is_nan_and_the_reason_a_fault(here):
    node = here.make(ForceOptimizerNode)
    sent = tapped(node)
    gone = Contacts(np.full((3, 3), np.nan), STATE.contacts.rotations)
    tick(node, 0, contacts=gone)
    for name in HAND.finger_names:
        codec = WrenchCodec(names.contact_frame(name), nan_allowed=True)
        assert np.isnan(codec.decode(sent[names.optimal_force(name)][-1])[1]).all()
    assert "no contact at finger 1, 2, 3" in level(node)[1]
    tick(node, TICK)
    assert level(node)[0] == OK


def test_a_torque_at_the_effort_limits_is_reported(here):
    node = here.make(ManipulationControllerNode)
    sent = tapped(node)
    limits = HAND.effort_limits
    tick(node, 0)
    assert level(node)[0] == OK and "fault torque" not in facts(node)
    command = tick(node, TICK, grasp_force=1e4)
    assert np.abs(command.torque / limits).max() == pytest.approx(1.0)
    assert (np.abs(command.torque) <= limits).all()
    assert level(node)[0] == WARN and "effort limit" in facts(node)["fault torque"]
    assert (np.abs(torque(sent)[1]) <= limits).all()
    tick(node, 2 * TICK)
    assert "fault torque" not in facts(node)


def test_code_is_loaded_before_the_first_tick(here, monkeypatch):
    """Loading it from the cache takes a hundred milliseconds on a busy computer."""
    used = set()

    def noted(module, name):
        before = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *args: used.add(name) or before(*args))

    for name in ("carried_along", "buckling_rate"):
        noted(controller, name)
    noted(sensing, "_best_delay")
    noted(holds, "_pulls")
    node = here.make(ManipulationControllerNode, **{"hold.latency": 5})
    assert used == {"carried_along", "buckling_rate", "_best_delay", "_pulls"}
    used.clear()
    assert tick(node, 0).mode is Mode.DRIVE and not used  # as a controller without a past


def test_a_tick_that_fails_is_answered_with_a_hold(here, monkeypatch):
    node = here.make(ManipulationControllerNode)
    sent = tapped(node)
    tick(node, 0)
    core = "tactile_hand_ros.control.controller.Controller.step"
    monkeypatch.setattr(core, lambda *_: {}["left"])
    command = tick(node, TICK)
    assert command.mode.value == "hold" and torque(sent)[0] == TICK
    np.testing.assert_array_equal(torque(sent)[1], command.torque)
    assert counts(node, "errors") == {"ticks": 1} and "KeyError" in level(node)[1]
    monkeypatch.undo()
    assert tick(node, 2 * TICK).mode.value == "drive"


def test_an_answer_that_is_better_not_sent_is_sent_when_time_waits_for_it(here):
    """That touch is rejected is published when it begins and when it ends."""
    node = here.make(ManipulationControllerNode)
    sent = tapped(node)
    here.receive(String, names.TOUCH_REJECTED, qos.latched_qos(10))
    here.messages(names.TOUCH_REJECTED, 1)  # a latched topic keeps the last message only
    for stamp in range(3):
        tick(node, stamp * TICK)
    command = tick(node, 3 * TICK, contacts=ODD)
    here.messages(names.TOUCH_REJECTED, 2)
    assert command.do_not_send and len(sent["joint_command"]) == 3
    assert node.touch_rejected.all()
    node.on_repeat()  # the same tick again
    assert torque(sent)[0] == 3 * TICK
    np.testing.assert_array_equal(torque(sent)[1], command.torque)
    assert not tick(node, 4 * TICK, contacts=ODD).do_not_send
    assert torque(sent)[0] == 4 * TICK
    tick(node, 5 * TICK)
    told = [message.data for message in here.messages(names.TOUCH_REJECTED, 3)]
    assert told == ["", ", ".join(HAND.finger_names), ""]


def test_where_time_is_known_to_wait_every_answer_is_sent(here):
    node = ManipulationControllerNode(composed=True, time_waits=True, context=here.context)
    here.add(node)
    sent = tapped(node)
    for stamp in range(4):
        contacts = ODD if stamp == 3 else STATE.contacts
        assert not tick(node, stamp * TICK, contacts=contacts).do_not_send
    node.on_repeat()  # as after a pause
    assert not tick(node, 4 * TICK, contacts=ODD).do_not_send
    assert len(sent["joint_command"]) == 6


def test_where_a_guard_holds_the_joints_a_blind_tick_is_not_answered(here):
    guard = here.user.create_publisher(Bool, names.JOINT_HOLD, qos.latched_qos())
    guard.publish(Bool(data=True))  # before the controller is there
    node = here.make(ManipulationControllerNode, composed=False)
    sent = tapped(node)
    topic = names.accepted_requests(names.CONTROLLER)
    here.receive(DiagnosticArray, topic)
    here.wait(lambda: node.joints_held, "the hold")
    tick(node, 0)
    node.on_blind_tick(TICK, JOINTS, "no contacts")
    assert len(sent["joint_command"]) == 1
    tick(node, 2 * TICK)
    here.call(Trigger, "manipulation_controller/reset")
    tick(node, 3 * TICK)
    guard.publish(Bool(data=False))
    here.wait(lambda: not node.joints_held, "its end")
    node.on_blind_tick(4 * TICK, JOINTS, "no contacts")
    assert torque(sent)[0] == 4 * TICK
    held = [each for each in asked(here.messages(topic, 6)) if each[0] == names.JOINT_HOLD]
    assert held == [
        (names.JOINT_HOLD, "true", 0),
        (names.JOINT_HOLD, "true", 3 * TICK),
        (names.JOINT_HOLD, "false", 4 * TICK),
    ]


def test_a_pose_is_published_when_it_becomes_the_target_with_that_tick(here):
    node = here.make(ManipulationControllerNode)
    here.receive(PoseStamped, names.ACCEPTED_POSE)
    rejected = names.rejected(names.CONTROLLER)
    here.receive(DiagnosticArray, rejected)
    tick(node, 0)
    position = CENTRE + [0.0, 0.01, 0.0]
    for stamp in (DAY + TICK, 3 * TICK):
        here.send(names.DESIRED_POSE, pose_message(position, np.eye(3), stamp))
    (refused,) = here.messages(rejected, 1)
    assert "ahead of the ticks" in refused.status[0].message
    for _ in range(20):
        here.wait(lambda: True)
    for number in range(1, 5):
        tick(node, number * TICK)
    (accepted,) = here.messages(names.ACCEPTED_POSE, 1)
    assert stamp_to_ns(accepted.header.stamp) == 3 * TICK
    assert accepted.pose == pose_message(position, np.eye(3), 0).pose


def test_a_pose_of_another_clock_is_rejected_at_the_first_tick_at_the_latest(here):
    node = here.make(ManipulationControllerNode)
    receive(node, DAY + 5 * TICK, DAY + 5 * TICK + 1)
    assert counts(node, "rejected") == {}  # the time of the ticks is not known yet
    tick(node, 5 * TICK)
    assert counts(node, "rejected") == {names.DESIRED_POSE: 1}
    receive(node, DAY + 5 * TICK, DAY + 5 * TICK + 1)
    assert counts(node, "rejected") == {names.DESIRED_POSE: 2}


def test_of_too_many_poses_for_later_the_earliest_are_dropped(here):
    node = here.make(ManipulationControllerNode)
    here.receive(PoseStamped, names.ACCEPTED_POSE)
    receive(node, *(number * TICK for number in range(1, MAX_WAITING + 4)))
    assert facts(node)["dropped_poses"] == "3"
    for number in range(6):
        tick(node, number * TICK)
    stamps = [stamp_to_ns(m.header.stamp) for m in here.messages(names.ACCEPTED_POSE, 2)]
    assert stamps == [4 * TICK, 5 * TICK]


def receive(node: Any, *stamps: int, offset: float = 0.0) -> None:
    """Pass desired poses to the node, off the centre of the contacts by so many m."""
    (found,) = (s for s in node.subscriptions if s.topic_name == f"/{names.DESIRED_POSE}")
    for stamp in stamps:
        message = pose_message(CENTRE + [0.0, offset, 0.0], np.eye(3), stamp)
        found.callback(serialize_message(message))


def test_ticks_that_start_over_forget_all_poses_but_those_sent_meanwhile(here):
    node = here.make(ManipulationControllerNode)
    here.receive(PoseStamped, names.ACCEPTED_POSE)

    def answers() -> list[list[float]]:
        return [list(tick(node, stamp * TICK).torque) for stamp in (0, 1)]

    still = answers()
    receive(node, 0, offset=0.05)
    pulled = list(tick(node, 2 * TICK).torque)
    node.on_restart()
    assert answers() == still and pulled not in still
    receive(node, 0, offset=0.01)
    node.on_restart()
    assert answers() != still
    poses = here.messages(names.ACCEPTED_POSE, 2)
    assert [stamp_to_ns(each.header.stamp) for each in poses] == [2 * TICK, 0]


def test_ticks_that_start_over_keep_a_grasp_force_that_was_requested_meanwhile(here):
    node = here.make(SlipRegulatorNode, mode="user", grasp_force=10.0, rise_rate=1e6)
    here.receive(WrenchStamped, names.ACCEPTED_FORCE)

    def request(force: float) -> None:
        topic = f"/{names.USER_GRASP_FORCE}"
        (found,) = [each for each in node.subscriptions if each.topic_name == topic]
        found.callback(serialize_message(Float64(data=force)))

    request(7.0)
    tick(node, 5 * TICK)
    node.on_restart()
    assert tick(node, 0) == tick(node, TICK) == 10.0
    request(12.0)
    node.on_restart()
    assert tick(node, 0) == 10.0 and tick(node, TICK) > 10.0
    forces = here.messages(names.ACCEPTED_FORCE, 2)
    assert [(stamp_to_ns(f.header.stamp), f.wrench.force.y) for f in forces] == [
        (5 * TICK, 7.0),
        (0, 12.0),
    ]


def test_a_minimum_that_exceeds_the_grasp_force_is_refused_and_changes_nothing(here):
    node = here.make(ForceOptimizerNode, minimum_normal=0.1)

    def change(name: str, value: Any) -> Any:
        return node.set_parameters([Parameter(name, value=value)])[0]

    refused = change("minimum_normal", 0.335)
    assert not refused.successful and "it must be below 0.333" in refused.reason
    assert node.get_parameter("minimum_normal").value == node.config.minimum_normal == 0.1
    assert change("weights", [1.0, 1.0, 1.0]).successful
    assert change("minimum_normal", 0.33).successful
    assert not [key for key in facts(node) if "fault" in key]


def test_services_change_the_controller_and_report_the_result(here):
    node = here.make(ManipulationControllerNode)
    topic = names.accepted_requests(names.CONTROLLER)
    here.receive(DiagnosticArray, topic)

    def ask(service: str, value: bool) -> tuple[bool, str]:
        answer = here.call(SetBool, f"manipulation_controller/{service}", data=value)
        return answer.success, answer.message

    assert ask("enable", False) == (True, "damping only")
    assert tick(node, 0).mode.value == "disabled"
    assert ask("enable", True) == (True, "enabled")
    refused, reason = ask("grasp", True)
    assert not refused and "no grasp was made yet" in reason
    tick(node, TICK)
    assert ask("grasp", True) == (True, "the hand holds already")
    assert ask("grasp", False) == (True, "opening")
    assert tick(node, 2 * TICK).mode.value == "open"
    assert ask("grasp", True) == (True, "closing")
    answer = here.call(Trigger, "manipulation_controller/reset")
    assert answer.success and "discarded" in answer.message
    tick(node, 3 * TICK)
    found = [(name, value) for name, value, _ in asked(here.messages(topic, 7))]
    assert found[:3] == [("enable", "true"), ("enable", "false"), ("enable", "true")]
    assert ("grasp", "false") in found and found[-1] == ("reset", "")


def test_forces_are_not_observed_where_the_controller_does_not_receive_them(here):
    unobserved = {"law.observer.time": 0.0}
    for composed in (False, True):
        node = here.make(ManipulationControllerNode, composed=composed, **unobserved)
        (result,) = node.set_parameters([Parameter("law.observer.time", value=0.25)])
        assert result.successful == composed
        assert ("does not subscribe to forces" in result.reason) != composed
