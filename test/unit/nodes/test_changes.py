# SPDX-License-Identifier: Apache-2.0
"""What nodes do besides answering ticks: changes, restarts, doubts, reports; no graph is needed."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.nodes.force_optimizer import ForceOptimizerNode
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.nodes.tactile_sensor import TactileSensorNode
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.messages.conversions import ContactPoses, stamp_to_ns
from tactile_hand_ros.ros.messages.wire import ContactsCodec, JointCodec, WrenchCodec
from tactile_hand_ros.ros.ticks.streams import Joints
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.miscalibration import Miscalibration
from tactile_hand_ros.simulation.plant import Plant, true_reading

TICK = 2_000_000
PLANT = Plant(load_scenario("paper").plant)
STATE, HAND = PLANT.state, PLANT.hand
TOUCH = true_reading(STATE)
POSES, STILL = ContactPoses(TOUCH.positions, TOUCH.quaternions), np.zeros(3)
JOINTS = Joints(STATE.theta, STATE.rates, STATE.torque)
PUSH = np.array([[0.3, 2.0, -0.1], [0.1, 3.0, 0.2], [-0.2, 2.5, 0.4]])
FRICTION = np.array([0.5, 0.6, 0.7])


def keep(publisher: Any) -> list[Any]:
    """Keep what a publisher publishes instead of sending it."""
    sent: list[Any] = []
    publisher.publish = sent.append
    return sent


def said(node: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in node.diagnostics.status().values}


class Optimizer:
    """An optimizer that shapes f*, and what it publishes."""

    def __init__(self, make: Callable[..., Any], **parameters: Any) -> None:
        self.node = make(ForceOptimizerNode, **{"cones": True, **parameters})
        self.sent = [keep(publisher) for publisher in self.node._force_publishers]
        self.requests = keep(self.node._accepted._requests)

    def tick(self, stamp: int, friction: Any = FRICTION, forces: Any = PUSH) -> np.ndarray:
        self.node.on_tick(stamp, STATE.contacts, friction, forces)
        found = [WrenchCodec(n, nan_allowed=True).decode(s[-1]) for n, s in self.by_frame()]
        assert {at for at, _ in found} == {stamp}
        return np.array([force for _, force in found])

    def by_frame(self) -> Any:
        frames = [names.contact_frame(name) for name in HAND.finger_names]
        return list(zip(frames, self.sent, strict=True))


@pytest.mark.parametrize(
    ("kind", "core", "steps", "resets"),
    [
        (SlipRegulatorNode, "slip_regulator.node.SlipRegulator", "step", 1),
        (SlipRegulatorNode, "slip_regulator.node.RegulatorReport", "note", 1),
        (ForceOptimizerNode, "force_optimizer.node.ForceOptimizer", "solve", 1),
        (TactileSensorNode, "tactile_sensor.node.TactileSensor", "step", 1),
        (ManipulationControllerNode, "manipulation_controller.node.Controller", "step", 1),
        (ManipulationControllerNode, "manipulation_controller.node.GraspMonitor", "margins", 0),
    ],
)
def test_a_tick_is_rehearsed_and_forgotten_before_the_first_one(
    make: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    kind: Any,
    core: str,
    steps: str,
    resets: int,
) -> None:
    module, name = core.rsplit(".", 1)
    owner = getattr(importlib.import_module(f"tactile_hand_ros.nodes.{module}"), name)
    calls: list[str] = []

    def counted(name: str) -> Any:
        real = getattr(owner, name)
        return lambda *args: calls.append(name) or real(*args)

    for each in (steps, "reset"):
        monkeypatch.setattr(owner, each, counted(each))
    node = make(kind)
    assert calls.count(steps) == 1 and calls[calls.index(steps) + 1 :] == ["reset"] * resets
    assert node.diagnostics.ticks == 0 and "latency_max_us" not in said(node)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (SlipRegulatorNode, "maximum", 33.0),
        (ForceOptimizerNode, "minimum_normal", 0.2),
        (ManipulationControllerNode, "law.k_p", 77.0),
    ],
)
def test_a_changed_parameter_is_taken_over_and_published_with_its_tick(
    make: Callable[..., Any], kind: Any, name: str, value: float
) -> None:
    node = make(kind)
    events = keep(node._accepted._parameters)
    node._accepted.take_effect(0)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert result.successful
    node._accepted.take_effect(TICK)
    node._accepted.take_effect(2 * TICK)
    assert [stamp_to_ns(event.stamp) for event in events] == [0, TICK]
    changed = {each.name: each.value.double_value for each in events[-1].changed_parameters}
    assert changed[name] == value
    cores = {"_regulator", "_optimizer", "_controller"} & set(vars(node))
    (core,) = (getattr(node, each) for each in cores)
    assert core.config == node.config


def asked(requests: list[Any]) -> list[tuple[str, str, int]]:
    found = [(m.status[0], stamp_to_ns(m.header.stamp)) for m in requests]
    return [(status.message, status.values[0].value, stamp) for status, stamp in found]


@pytest.mark.parametrize("kind", [SlipRegulatorNode, ForceOptimizerNode])
def test_a_doubt_is_passed_on_once_and_stays_when_the_ticks_start_over(
    make: Callable[..., Any], kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make(kind, **({"cones": True} if kind is ForceOptimizerNode else {}))
    requests = keep(node._accepted._requests)
    core = node._optimizer if kind is ForceOptimizerNode else node._regulator
    doubts: list[bool] = []
    monkeypatch.setattr(core, "reject_touch", doubts.append)
    node._on_doubt(Bool(data=False))
    node.on_restart()
    node._accepted.take_effect(0)
    assert doubts == [] and requests == []
    for doubted in (True, True):
        node._on_doubt(Bool(data=doubted))
    node._accepted.take_effect(1)
    node.on_restart()
    node._accepted.take_effect(2)
    node._on_doubt(Bool(data=False))
    node._accepted.take_effect(3)
    assert doubts == [True, False]
    told = names.TOUCH_REJECTED
    assert asked(requests) == [(told, "true", 1), (told, "true", 2), (told, "false", 3)]


def test_ticks_that_start_over_find_nothing_of_before(make: Callable[..., Any]) -> None:
    """And what is in force is published again."""
    hand = Optimizer(make, **{"shape_time": 0.0})
    regulator = make(SlipRegulatorNode)
    events = [keep(node._accepted._parameters) for node in (hand.node, regulator)]
    first = hand.tick(0)
    hand.tick(TICK, FRICTION, 2.0 * PUSH[::-1])
    hand.node.on_restart()
    np.testing.assert_array_equal(hand.tick(0), first)
    regulator._report._slips[:] = 3
    regulator._regulator.step(0, STATE.contacts, PUSH)
    regulator.on_restart()
    assert not regulator._report._slips.any()
    regulator._accepted.take_effect(5)
    assert [stamp_to_ns(event.stamp) for event in events[0]] == [0, 0]
    assert [stamp_to_ns(event.stamp) for event in events[1]] == [5]


def test_a_regulator_that_is_late_feels_every_tick(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make(SlipRegulatorNode)
    requests, squeezes = keep(node._accepted._requests), keep(node._publisher)
    felt: list[Any] = []
    monkeypatch.setattr(node._regulator, "step", lambda *args: felt.append(args))
    node._accepted.request("reset")
    node._observe(4, STATE.contacts, PUSH)
    assert felt == [(4, STATE.contacts, PUSH)] and squeezes == []
    assert asked(requests) == [("reset", "", 4)]


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        (SlipRegulatorNode, names.USER_GRASP_FORCE),
        (ManipulationControllerNode, names.DESIRED_POSE),
    ],
)
def test_a_refused_command_is_answered_with_the_reason(
    make: Callable[..., Any], kind: Any, command: str
) -> None:
    node = make(kind)
    answers = keep(node._accepted._rejected)
    node.reject(command, "too far")
    (answer,) = answers
    pairs = [(pair.key, pair.value) for pair in answer.status[0].values]
    assert pairs == [(command, "too far")] and answer.status[0].level == DiagnosticStatus.WARN


def test_latencies_are_those_of_a_tick(make: Callable[..., Any]) -> None:
    regulator, sensor = make(SlipRegulatorNode), make(TactileSensorNode)
    controller = make(ManipulationControllerNode)
    began = time.perf_counter()
    regulator.on_tick(0, STATE.contacts, PUSH)
    sensor.on_tick(0, POSES, STILL, TOUCH.forces)
    controller.on_tick(0, JOINTS, STATE.contacts, 10.0, np.tile([0.0, 1 / 3, 0.0], (3, 1)), None)
    longest = 1e6 * (time.perf_counter() - began)
    for node in (regulator, sensor, controller):
        assert 0.0 <= float(said(node)["latency_max_us"]) <= longest + 1.0


def test_a_doubt_is_published_when_it_begins_and_when_it_ends(make: Callable[..., Any]) -> None:
    node = make(ManipulationControllerNode)
    doubts = keep(node._doubt)
    for doubted in (False, True, True, False, False):
        node._controller.touch_rejected = doubted
        node._publish_doubt()
    assert [message.data for message in doubts] == [True, False]


def test_a_controller_reports_missing_inputs_publishers_and_margins(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make(ManipulationControllerNode)
    calls: list[Any] = []
    module = importlib.import_module("tactile_hand_ros.nodes.manipulation_controller")
    monkeypatch.setattr(module, "report_publishers", lambda *args: calls.append(args))
    monkeypatch.setattr(node._inputs, "report", lambda: calls.append("inputs"))
    monkeypatch.setattr(node._report, "report", lambda target: calls.append(target))
    node._controller._target = None
    node.on_report()
    assert calls == ["inputs", (node, names.JOINT_STATES), node._controller.target]


def test_a_grasp_that_is_refused_changes_nothing_and_says_why(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make(ManipulationControllerNode)
    requests = keep(node._accepted._requests)
    node._accepted.take_effect(0)
    requests.clear()

    def refuse() -> None:
        raise GraspError("no finger is open")

    monkeypatch.setattr(node._controller, "grasp", refuse)
    answer = node._requests._on_grasp(SetBool.Request(data=True), SetBool.Response(success=True))
    node._accepted.take_effect(1)
    assert (answer.success, answer.message) == (False, "no finger is open") and requests == []


def test_a_reset_of_the_controller_forgets_poses_grasp_and_margins(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, calls = make(ManipulationControllerNode), list[str]()
    events = keep(node._accepted._parameters)
    for owner, name in (
        (node._desired, "forget"),
        (node._desired, "command_again"),
        (node._controller, "forget"),
        (node._controller, "reset"),
        (node._report, "reset"),
    ):
        tag = f"{type(owner).__name__}.{name}"
        monkeypatch.setattr(owner, name, lambda tag=tag: calls.append(tag))
    node._on_reset()
    common = ["ControllerReport.reset", "DesiredPoses.command_again"]
    assert calls == ["DesiredPoses.forget", "Controller.forget", *common]
    calls.clear()
    node.on_restart()
    assert calls == ["Controller.reset", *common]
    node._accepted.take_effect(3)
    assert [stamp_to_ns(event.stamp) for event in events] == [3]


class Sensor:
    """A sensor and what it publishes."""

    def __init__(self, make: Callable[..., Any], **parameters: Any) -> None:
        self.node = make(TactileSensorNode, **parameters)
        publisher = self.node._publisher
        self.contacts = keep(publisher._contacts_publisher)
        self.forces = [keep(each) for each in publisher._wrench_publishers]

    def tick(self, stamp: int, *joints: Joints) -> tuple[Any, Any]:
        self.node.on_tick(stamp, POSES, STILL, TOUCH.forces + PUSH, *joints)
        at, poses = ContactsCodec(3).decode(self.contacts[-1])
        frames = [names.contact_frame(name) for name in HAND.finger_names]
        pairs = zip(frames, self.forces, strict=True)
        found = [WrenchCodec(frame).decode(sent[-1]) for frame, sent in pairs]
        assert {at, *(stamp for stamp, _ in found)} == {stamp}
        return poses.positions, np.array([force for _, force in found])


def test_a_perfect_skin_reports_what_is_true_and_repeats_it_to_the_byte(
    make: Callable[..., Any],
) -> None:
    skin = Sensor(make)
    positions, forces = skin.tick(5)
    np.testing.assert_array_equal(positions, TOUCH.positions)
    np.testing.assert_array_equal(forces, TOUCH.forces + PUSH)
    assert skin.node.diagnostics.ticks == 1
    skin.node.on_repeat()
    for sent in (skin.contacts, *skin.forces):
        assert len(sent) == 2 and sent[0] == sent[1]


def test_before_the_first_tick_there_is_nothing_to_repeat(make: Callable[..., Any]) -> None:
    skin = Sensor(make)
    skin.node.on_repeat()
    assert skin.contacts == [] and all(sent == [] for sent in skin.forces)


def test_noise_is_live_and_repeats_when_the_ticks_start_over(make: Callable[..., Any]) -> None:
    skin = Sensor(make, force_noise=0.1)
    _, first = skin.tick(0)
    assert not np.array_equal(first, TOUCH.forces + PUSH)
    assert not np.array_equal(skin.tick(TICK)[1], first)
    skin.node.on_restart()
    np.testing.assert_array_equal(skin.tick(0)[1], first)
    skin.node.set_parameters([Parameter("force_noise", value=0.0)])
    np.testing.assert_array_equal(skin.tick(TICK)[1], TOUCH.forces + PUSH)


def test_a_wrong_calibration_moves_contacts_with_the_joints(make: Callable[..., Any]) -> None:
    wrong = [0.0, 0.0, 0.1]
    skin = Sensor(make, **{"calibration.skin_rotation": wrong})
    positions, forces = skin.tick(5, JOINTS)
    true = true_reading(STATE)
    felt = type(true)(true.positions, true.quaternions, true.forces + PUSH)
    expected = Miscalibration(skin.node.config.calibration, HAND).step(STATE.theta, felt)
    np.testing.assert_allclose(positions, expected.positions)
    np.testing.assert_allclose(forces, expected.forces)
    assert np.abs(positions - TOUCH.positions).max() > 1e-4


def test_a_plant_repeats_what_others_wait_for_to_the_byte(make: Callable[..., Any]) -> None:
    topics = make(PlantNode)._driver._topics
    publishers = (topics._slip_publisher, topics._joints_publisher)
    sent = [keep(each) for each in (*publishers, topics._truth._contacts_publisher)]
    poses = keep(topics._pose_publisher)
    topics.publish(STATE, TICK)
    topics.repeat()
    assert all(len(each) == 2 and each[0] == each[1] for each in sent) and len(poses) == 1


def test_a_plant_takes_commands_by_joint_name(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, taken = make(PlantNode), list[Any]()
    monkeypatch.setattr(node._driver, "command", lambda *args: taken.append(args))
    torque = np.linspace(0.1, 0.9, HAND.joints)
    codec = JointCodec(HAND.joint_names, ("effort",))
    node._on_command(codec.encode(7, torque))
    ((stamp, got),) = taken
    assert stamp == 7
    np.testing.assert_array_equal(got, torque)


def test_the_services_of_a_plant_answer_with_its_mode(make: Callable[..., Any]) -> None:
    node = make(PlantNode)

    def run(on: bool) -> tuple[bool, str]:
        answer = node._on_run(SetBool.Request(data=on), SetBool.Response())
        return answer.success, answer.message

    assert run(False) == (True, "paused") and run(True) == (True, "running")
    node._driver.command(0, np.zeros(HAND.joints))
    assert node._run.stamp == TICK
    answer = node._on_reset(Trigger.Request(), Trigger.Response())
    assert (answer.success, answer.message) == (True, "running") and node._run.stamp == 0
    node._driver._is_finished = True
    assert run(True) == (False, "finished")


def test_a_plant_takes_another_friction_and_goes_to_its_safe_state(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, held = make(PlantNode), list[str]()
    node.set_parameters([Parameter("object.friction", value=0.25)])
    np.testing.assert_array_equal(node._run.plant.friction, 0.25)
    monkeypatch.setattr(node._driver, "to_safe_state", held.append)
    node.to_safe_state("why")
    assert held == ["why"]
    monkeypatch.setattr(node._driver, "close", lambda: held.append("closed"))
    node.close()
    assert held == ["why", "closed"]


def test_a_plant_reports_touch_and_laws_that_were_not_met(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, topics = make(PlantNode), list[str]()
    module = importlib.import_module("tactile_hand_ros.nodes.plant.node")
    monkeypatch.setattr(module, "report_publishers", lambda _, topic: topics.append(topic))
    monkeypatch.setattr(module, "required_friction", lambda forces: np.array([0.25, 0.5, 0.125]))
    node.on_report()
    facts = said(node)
    assert topics == [names.JOINT_COMMAND, names.JOINT_STATES] and facts["mode"] == "running"
    assert (facts["touching"], facts["required_friction"]) == ("3", "0.5")
    assert (facts["relaxed_steps"], facts["unsolved_steps"]) == ("0", "0")
    assert float(facts["contact_residual"]) == pytest.approx(node._run.plant.contact_residual)
    assert not any(key.startswith("fault") for key in facts)
    monkeypatch.setattr(module, "required_friction", lambda forces: np.empty(0))
    for relaxed, unsolved in ((1, 0), (0, 1)):
        monkeypatch.setattr(node._run.plant, "relaxed_steps", relaxed)
        monkeypatch.setattr(node._run.plant, "unsolved_steps", unsolved)
        node.on_report()
        status = node.diagnostics.status()
        assert status.level == WARN and said(node)["required_friction"] == "0"
        assert f"relaxed in {relaxed} steps" in status.message
        assert f"not met in {unsolved} since" in status.message
