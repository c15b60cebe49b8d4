# SPDX-License-Identifier: Apache-2.0
"""All nodes in one process: the numbers of the closed loop, and ordinary nodes alongside."""

from typing import Any

from geometry_msgs.msg import PoseArray, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from support.messages import encoded
from support.nodes import Process, counts, facts, tapped

from bench.processes import parameter_files
from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.nodes import composed
from tactile_hand_ros.ros.qos import TICK_DEPTH, USER_DEPTH, latched_qos
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

TICKS = 60


def short(name: str = "pull", **changes: Any) -> Scenario:
    duration = TICKS / 1000.0 if name == "pull" else TICKS / 500.0
    values = {"duration": duration, "targets": [], "plant.autostart": False, **changes}
    return load_scenario(name, values)


def start(here: Process, scenario: Scenario, tmp_path: Any, *, controllers: bool = False) -> Any:
    """Make the nodes of a composition with the parameters of a scenario; return them by name."""
    arguments = ["--ros-args", *parameter_files(scenario, tmp_path)]
    make = composed.controller_nodes if controllers else composed.composed_nodes
    nodes = {node.get_name(): node for node in make(context=here.context, cli_args=arguments)}
    here.add(*nodes.values())
    return nodes


def run_to_the_end(here: Process, plant: Any) -> None:
    assert here.call(SetBool, "plant/run", data=True).success
    here.wait(lambda: not plant.work() and facts(plant)["mode"] == "finished", "the end")


def test_the_bytes_are_those_of_the_closed_loop(tmp_path, here):
    """Also after the ticks have started over."""
    scenario = short(**{"tactile_sensor.force_noise": 0.05})
    expected = encoded(ClosedLoop(scenario).run(TICKS))
    nodes = start(here, scenario, tmp_path)
    sent = [tapped(node) for node in nodes.values()]
    run_to_the_end(here, nodes["plant"])
    for again in (True, False):
        found = {f"/{topic}": data for each in sent for topic, data in each.items()}
        assert {topic: found[topic][:TICKS] for topic in expected} == expected
        for data in found.values():
            data.clear()
        if again:
            assert here.call(Trigger, "plant/reset").success
            run_to_the_end(here, nodes["plant"])


def test_nothing_is_encoded_when_nobody_wants_it(tmp_path, monkeypatch, here):
    nodes = start(here, short(), tmp_path)
    encoded: list[int] = []
    template = "tactile_hand_ros.ros.messages.CdrTemplate.stamped"
    monkeypatch.setattr(template, lambda _, stamp: encoded.append(stamp) or b"")
    run_to_the_end(here, nodes["plant"])
    assert encoded == []
    assert int(facts(nodes["manipulation_controller"])["ticks"]) >= TICKS


def test_a_node_that_fails_leaves_its_tick_without_a_command(tmp_path, monkeypatch, here):
    """In real time, at a rate that a busy machine keeps, the guard holds the joints meanwhile."""
    scenario = short("paper", **{"plant.pacing": "realtime", "plant.rate": 10.0, "duration": 60.0})
    nodes = start(here, scenario, tmp_path)
    plant, regulator = nodes["plant"], nodes["slip_regulator"]
    assert here.call(SetBool, "plant/run", data=True).success
    here.wait(lambda: int(facts(regulator)["ticks"]) > 5, "ticks")
    core = "tactile_hand_ros.control.slip.regulator.SlipRegulator.step"
    monkeypatch.setattr(core, lambda *_: {}["left"])
    here.wait(lambda: "ticks" in counts(regulator, "errors"), "the failure")
    here.wait(lambda: facts(plant)["mode"] == "holding", "the hold")
    monkeypatch.undo()
    here.wait(lambda: facts(plant)["mode"] == "running", "the end of the hold")


def test_the_controllers_of_a_real_hand_receive_that_a_guard_holds(tmp_path, here):
    nodes = start(here, short("paper"), tmp_path, controllers=True)
    for held in (True, False):
        here.send(names.JOINT_HOLD, Bool(data=held), latched_qos(USER_DEPTH))
        node = nodes["manipulation_controller"]
        here.wait(lambda held=held, node=node: node.joints_held == held, "its state")


def test_the_controllers_of_a_real_hand_answer_joints_and_touch(tmp_path, here):
    """Fed with what the drivers of a hand publish, they answer as in the closed loop."""
    scenario = short("paper")
    run = ClosedLoop(scenario).run(20)
    expected = encoded(run)
    nodes = start(here, scenario, tmp_path, controllers=True)
    sent = tapped(nodes["manipulation_controller"])[names.JOINT_COMMAND]
    kinds = {names.JOINT_STATES: JointState, names.CONTACTS: PoseArray}
    kinds |= dict.fromkeys(map(names.wrench, run.finger_names), WrenchStamped)
    drivers = [here.user.create_publisher(kinds[topic], topic, TICK_DEPTH) for topic in kinds]
    for each in drivers:
        here.wait(lambda each=each: each.get_subscription_count() == 1, each.topic_name)
    for row, stamp in enumerate(run.stamps):
        for each in drivers:
            each.publish(expected[each.topic_name][row])
        here.wait(lambda row=row: len(sent) == row + 1, f"the answer to {stamp}")
    assert sent == expected[f"/{names.JOINT_COMMAND}"]
