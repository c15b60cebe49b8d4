# SPDX-License-Identifier: Apache-2.0
"""What regulator, controller and plant do at a tick: real nodes, called without a graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger
from support.messages import pose_message

from tactile_hand_ros import names
from tactile_hand_ros.control.controller import Command, Mode
from tactile_hand_ros.control.laws import AuxiliaryPose
from tactile_hand_ros.errors import ConfigurationError, UnsafeOutputError
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.ros.diagnostics import OK, WARN
from tactile_hand_ros.ros.messages.conversions import stamp_to_ns
from tactile_hand_ros.ros.messages.wire import JointCodec, PoseCodec, WrenchCodec
from tactile_hand_ros.ros.ticks.streams import Joints
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

TICK = 2_000_000
PLANT = Plant(load_scenario("paper").plant)
STATE, HAND = PLANT.state, PLANT.hand
JOINTS = Joints(STATE.theta, STATE.rates, STATE.torque)


def keep(publisher: Any) -> list[Any]:
    """Keep what a publisher publishes instead of sending it."""
    sent: list[Any] = []
    publisher.publish = sent.append
    return sent


def level(node: Any) -> tuple[bytes, str]:
    status = node.diagnostics.status()
    return status.level, status.message


class Regulator:
    """A regulator and what it publishes."""

    def __init__(self, make: Callable[..., Any], **parameters: Any) -> None:
        self.node = make(SlipRegulatorNode, **parameters)
        self.squeezes = keep(self.node._publisher)
        self.grips = keep(self.node._grip_publisher)
        self.haptics: list[tuple[float, ...]] = []
        self.node._haptic_publisher.publish = lambda message: self.haptics.append(
            tuple(round(each.intensity, 6) for each in message.array)
        )

    def tick(self, stamp: int) -> float:
        self.node.on_tick(stamp, STATE.contacts, STATE.forces)
        _, force = WrenchCodec(names.PALM_FRAME).decode(self.squeezes[-1])
        return float(force[1])


def test_the_users_hand_is_told_every_20_ms_of_the_ticks(make: Callable[..., Any]) -> None:
    hand = Regulator(make, grasp_force=10.0, maximum=40.0)
    evidence = iter([0.0, 0.5, 0.25, 0.0, 0.125])

    def tell(stamp: int) -> None:
        hand.node._tell_user(stamp, 0.25, next(evidence))

    tell(0)
    assert hand.haptics == [(0.25, 0.0)]
    tell(10_000_000)
    tell(19_999_999)
    assert len(hand.haptics) == 1
    tell(20_000_000)
    assert hand.haptics[-1] == (0.25, 0.5)  # the strongest since then
    tell(40_000_000)
    assert hand.haptics[-1] == (0.25, 0.125)


def test_a_tick_is_answered_with_k_f_and_grip_and_repeated_to_the_byte(
    make: Callable[..., Any],
) -> None:
    hand = Regulator(make, grasp_force=10.0, maximum=40.0)
    assert hand.tick(0) == 10.0 and hand.haptics == [(0.25, 0.0)]
    hand.node.on_repeat()
    assert hand.squeezes[0] == hand.squeezes[1] and hand.grips[0] == hand.grips[1]
    grip = deserialize_message(hand.grips[0], JointState)
    assert list(grip.name) == ["finger_1", "finger_2", "finger_3"]
    assert hand.node.diagnostics.ticks == 1
    shown = {pair.key for pair in hand.node.diagnostics.status().values}
    assert "latency_max_us" in shown


@pytest.mark.parametrize("force", [0.0, 40.0])
def test_a_squeeze_up_to_its_limits_is_published(make: Callable[..., Any], force: float) -> None:
    assert Regulator(make, maximum=40.0).node._checked(force) == force


@pytest.mark.parametrize("force", [-1e-9, 40.0001, np.nan, np.inf])
def test_no_squeeze_beyond_its_limits_is_published(make: Callable[..., Any], force: float) -> None:
    with pytest.raises(UnsafeOutputError, match="is not from 0 to 40.0 N"):
        Regulator(make, maximum=40.0).node._checked(force)


def test_a_reset_goes_back_to_the_configured_squeeze(make: Callable[..., Any]) -> None:
    hand = Regulator(make, grasp_force=10.0, mode="user")
    forces = keep(hand.node._force_publisher)
    requests = keep(hand.node._accepted._requests)
    hand.tick(0)
    hand.node._on_user_force(serialize_message(Float64(data=12.0)))
    assert forces == []
    assert hand.tick(TICK) > 10.0
    stamp, force = WrenchCodec(names.PALM_FRAME).decode(forces[-1])
    assert (stamp, list(force)) == (TICK, [0.0, 12.0, 0.0])
    answer = hand.node._on_reset(Trigger.Request(), Trigger.Response())
    assert (answer.success, answer.message) == (True, "k_f = 10 N")
    assert hand.tick(2 * TICK) == 10.0
    assert [message.status[0].message for message in requests] == ["reset"]


class Controller:
    """A controller and what it publishes."""

    def __init__(self, make: Callable[..., Any], **parameters: Any) -> None:
        self.node = make(ManipulationControllerNode, **parameters)
        self.commands = keep(self.node._command_publisher)
        self.poses = keep(self.node._pose_publisher)
        self.accepted = keep(self.node._desired._publisher)
        self.requests = keep(self.node._accepted._requests)

    def tick(self, stamp: int) -> None:
        share = np.tile([0.0, 1.0 / 3.0, 0.0], (3, 1))
        self.node.on_tick(stamp, JOINTS, STATE.contacts, 10.0, share, None)

    def torque(self) -> tuple[int, Any]:
        stamp, (torque,) = JointCodec(HAND.joint_names, ("effort",)).decode(self.commands[-1])
        return stamp, torque

    def asked(self) -> list[tuple[str, str]]:
        return [(m.status[0].message, m.status[0].values[0].value) for m in self.requests]


def test_a_torque_up_to_the_effort_limits_passes_and_more_is_cut_off_with_a_warning(
    make: Callable[..., Any],
) -> None:
    node = Controller(make).node
    limits = HAND.effort_limits
    np.testing.assert_array_equal(node._limited(limits), limits)
    np.testing.assert_array_equal(node._limited(-limits), -limits)
    assert level(node)[0] == OK
    over = -0.5 * limits
    over[1], over[4] = 1.5 * limits[1], -2.0 * limits[4]
    cut = node._limited(over)
    assert (cut[1], cut[4]) == (limits[1], -limits[4]) and cut[0] == over[0]
    assert level(node) == (
        WARN,
        "a joint is at the effort limit of the URDF; squeeze less or lower the gains",
    )
    node._limited(over)
    assert level(node)[0] == WARN
    node._limited(0.5 * limits)
    assert level(node)[0] == OK


def test_a_tick_is_answered_with_torque_and_pose_and_again_on_demand(
    make: Callable[..., Any],
) -> None:
    hand = Controller(make)
    hand.tick(0)
    stamp, torque = hand.torque()
    assert stamp == 0 and np.abs(torque).max() > 0.0
    pose = deserialize_message(hand.poses[-1], PoseStamped).pose.position
    centre = STATE.contacts.positions.mean(axis=0)
    np.testing.assert_allclose([pose.x, pose.y, pose.z], centre)
    assert hand.asked() == [("enable", "true")]
    hand.node.on_repeat()
    assert hand.commands[1] == hand.commands[0] and len(hand.poses) == 1
    assert hand.node.diagnostics.ticks == 1


def test_an_answer_that_is_withheld_is_given_once_time_waits_for_it(
    make: Callable[..., Any],
) -> None:
    hand = Controller(make)
    step = hand.node._controller.step
    do_not_send = [True, True, False, True]

    def doubtful(*inputs: Any) -> Command:
        command: Command = step(*inputs)
        return command._replace(do_not_send=do_not_send.pop(0))

    hand.node._controller.step = doubtful
    hand.tick(0)
    assert hand.commands == [] and hand.requests == []
    hand.node.on_repeat()
    assert hand.torque()[0] == 0
    hand.tick(TICK)  # do_not_send no more: in lockstep time waits
    assert hand.torque()[0] == TICK and len(hand.requests) == 1
    hand.tick(2 * TICK)
    hand.node.on_repeat()
    hand.tick(3 * TICK)  # an answer that was sent again was none that was do_not_send
    assert hand.torque()[0] == 2 * TICK


def test_a_tick_that_fails_is_answered_with_a_hold_once(make: Callable[..., Any]) -> None:
    hand = Controller(make)
    hand.node.to_safe_state("KeyError")
    assert hand.commands == []  # no tick waits
    hand.tick(0)
    hand.node.to_safe_state("KeyError")
    assert len(hand.commands) == 1  # it is answered already

    def fail(*_: Any) -> Command:
        raise KeyError("left")

    hand.node._controller.step = fail
    with pytest.raises(KeyError):
        hand.tick(TICK)
    hand.node.to_safe_state("KeyError")
    hand.node.to_safe_state("KeyError")
    assert hand.torque()[0] == TICK and len(hand.commands) == 2
    assert hand.node._report._last.mode is Mode.HOLD


def test_where_a_guard_holds_the_joints_a_blind_tick_is_not_answered(
    make: Callable[..., Any],
) -> None:
    hand = Controller(make)
    hand.tick(0)
    hand.node._on_joint_hold(Bool(data=True))
    hand.node._on_joint_hold(Bool(data=True))
    hand.node.on_blind_tick(TICK, JOINTS, "no contacts")
    assert len(hand.commands) == 1
    hand.tick(2 * TICK)
    assert hand.asked()[1:] == [("joint_hold", "true")]
    hand.node._on_reset()
    hand.tick(3 * TICK)
    assert hand.asked()[2:] == [("enable", "true"), ("joint_hold", "true")]
    hand.node._on_joint_hold(Bool(data=False))
    hand.node.on_blind_tick(4 * TICK, JOINTS, "no contacts")
    assert hand.torque()[0] == 4 * TICK and hand.asked()[4:] == [("joint_hold", "false")]


def test_a_pose_is_published_when_it_becomes_the_target_with_that_tick(
    make: Callable[..., Any],
) -> None:
    hand = Controller(make)
    hand.tick(0)
    position = STATE.contacts.positions.mean(axis=0) + [0.0, 0.01, 0.0]
    message = pose_message(position, np.eye(3), 3 * TICK)
    hand.node._desired.take(serialize_message(message))
    for tick in range(1, 5):
        hand.tick(tick * TICK)
    (accepted,) = hand.accepted
    assert stamp_to_ns(accepted.header.stamp) == 3 * TICK
    assert accepted.pose == message.pose


def test_forces_are_not_observed_where_the_controller_does_not_listen_to_them(
    make: Callable[..., Any],
) -> None:
    deaf, feeling = (Controller(make, **{"law.observer.time": time}).node for time in (0.0, 0.5))
    wanted = deaf.config.changed({"law.observer.time": 0.25})
    with pytest.raises(ConfigurationError, match="does not listen to forces"):
        deaf.check_config(wanted)
    deaf.check_config(deaf.config)
    feeling.check_config(wanted)
    feeling.check_config(deaf.config)


def test_services_change_the_controller_and_say_what_became_of_it(
    make: Callable[..., Any],
) -> None:
    hand = Controller(make)
    services, controller = hand.node._requests, hand.node._controller

    def ask(callback: Any, value: bool) -> tuple[bool, str]:
        answer = callback(SetBool.Request(data=value), SetBool.Response())
        return answer.success, answer.message

    assert ask(services._on_enable, False) == (True, "damping only")
    assert not controller.enabled
    hand.tick(0)
    assert ask(services._on_enable, True) == (True, "enabled") and controller.enabled
    already = "the hand is not open, nothing to close"
    assert ask(services._on_grasp, True) == (True, already)
    hand.tick(TICK)
    assert ask(services._on_grasp, False) == (True, "opening")
    hand.tick(2 * TICK)
    assert controller.is_open and ask(services._on_grasp, True) == (True, "closing")
    answer = services._on_reset(Trigger.Request(), Trigger.Response())
    assert answer.success and "forgotten" in answer.message
    hand.tick(3 * TICK)
    asked = hand.asked()
    assert asked[:3] == [("enable", "true"), ("enable", "false"), ("enable", "true")]
    assert ("grasp", "false") in asked and asked[-1] == ("reset", "")


def test_the_auxiliary_pose_has_the_frame_of_the_contacts(make: Callable[..., Any]) -> None:
    hand = Controller(make)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = AuxiliaryPose(np.array([0.1, 0.2, 0.3]), turn)
    hand.node._answer(7, Command(np.zeros(9), Mode.DRIVE, pose))
    quaternion = quaternion_from_rotation(turn)
    np.testing.assert_allclose(quaternion, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    assert hand.poses == [PoseCodec().encode(pose.position, quaternion, 7)]
    hand.node._answer(8, Command(np.zeros(9), Mode.HOLD, None))
    assert len(hand.poses) == 1
