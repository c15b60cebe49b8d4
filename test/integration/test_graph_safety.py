# SPDX-License-Identifier: Apache-2.0
"""Whatever is sent or dies, the object stays in the hand, the nodes say so, and the run goes on."""

import math
import signal
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from support.graph import Graph

from bench.processes import isolated_domain
from tactile_hand_ros import names
from tactile_hand_ros.ros.diagnostics import ERROR
from tactile_hand_ros.scenario.scenario import load_scenario

P_D = np.array(load_scenario("paper").targets[0].position)
SHORTER = {
    "duration": 86400.0,
    "plant.autostart": False,
    "plant.rate": 250.0,
    "plant.command_timeout": 0.4,
    "manipulation_controller.input_timeout": 0.2,
}


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """Run the paper's scenario without end; time-outs are short so that tests are."""
    folder = tmp_path_factory.mktemp("graph")
    scenario = load_scenario("paper", SHORTER)
    with isolated_domain() as domain, Graph(scenario, domain, folder) as started:
        yield started
        assert set(started.end(signal.SIGINT).values()) == {0}


@pytest.fixture(autouse=True)
def moving(graph: Graph) -> None:
    """Start over: the hand is on its way to p_d."""
    graph.begin(P_D)
    graph.wait(lambda: graph.time > 0.1, "the first ticks")


def distance(graph: Graph) -> float:
    """Return how far the hand believes to be from p_d [m]."""
    return float(np.linalg.norm(graph.position(names.AUXILIARY_POSE) - P_D))


def pass_time(graph: Graph, seconds: float) -> None:
    """Wait until simulated time has passed."""
    until = graph.time + seconds
    graph.wait(lambda: graph.time >= until, f"t = {until:g} s")


def assert_held(graph: Graph) -> None:
    """All fingers touch, none lets go and none crushes."""
    assert np.isfinite(graph.contacts).all()
    normal = graph.forces[:, 1]
    assert (normal > 0.5).all() and (normal < 20.0).all()


def says(graph: Graph, name: str, level: bytes, text: str) -> bool:
    health = graph.health.get(f"/{name}")
    return health is not None and health.level == level and text in health.message


def stranger(graph: Graph, kind: Any, topic: str) -> Publisher:
    """Return a publisher that should not be there, connected with all that listen."""
    listeners = graph.node.count_subscribers(topic)
    publisher = graph.node.create_publisher(kind, topic, 10)
    graph.wait(lambda: publisher.get_subscription_count() >= listeners, f"readers of {topic}")
    return publisher


def effort(graph: Graph, torque: float) -> JointState:
    """Return a command for the newest tick, with the same torque for all joints [N m]."""
    state = graph.newest(names.JOINT_STATES)
    message = JointState(name=list(state.name), effort=[torque] * len(state.name))
    message.header.stamp = state.header.stamp
    return message


MISSED = {"tactile_sensor": "tactile/contacts", "slip_regulator": "grasp_force"}


@pytest.mark.parametrize("victim", MISSED)
def test_the_hand_holds_without_a_node_and_moves_on_when_it_is_back(graph, victim):
    graph.kill(victim)
    at = graph.position()
    graph.wait(
        lambda: says(graph, "manipulation_controller", ERROR, MISSED[victim]), "a controller's word"
    )
    pass_time(graph, 1.0)
    assert_held(graph)
    assert np.linalg.norm(graph.position() - at) < 0.005
    assert graph.says("manipulation_controller", "mode", "hold")
    far = distance(graph)
    graph.start(victim)
    graph.wait(lambda: graph.says("manipulation_controller", "mode", "drive"), "the motion")
    graph.wait(lambda: distance(graph) < 0.8 * far, "the way to p_d")
    assert_held(graph)


def test_the_joints_are_held_without_a_controller_until_it_is_back(graph):
    """Commands that cannot be used do not count as a controller."""
    graph.kill("manipulation_controller")
    at = graph.position()
    publisher = stranger(graph, JointState, names.JOINT_COMMAND)
    before = graph.rejected("plant", "joint_command")
    graph.wait(lambda: says(graph, "plant", ERROR, "no usable joint_command"), "the plant's word")
    assert graph.says("plant", "mode", "holding")
    publisher.publish(effort(graph, math.nan))
    graph.wait(lambda: graph.rejected("plant", "joint_command") == before + 1, "a rejection")
    graph.node.destroy_publisher(publisher)
    pass_time(graph, 1.0)
    assert_held(graph)
    assert np.linalg.norm(graph.position() - at) < 0.005
    graph.start("manipulation_controller")
    graph.wait(lambda: graph.says("plant", "mode", "running"), "commands")
    assert np.linalg.norm(graph.position() - at) < 0.005
    graph.wait(lambda: graph.hears("manipulation_controller", "desired_pose"), "its readiness")
    graph.desire(P_D)
    graph.wait(lambda: np.linalg.norm(graph.position() - at) > 0.02, "the motion")
    assert_held(graph)


def test_two_senders_that_disagree_are_answered_with_a_hold(graph):
    """A second controller that was started by mistake, say; what it sends moves nothing."""
    publisher = stranger(graph, JointState, names.JOINT_COMMAND)
    at = graph.position()

    def disagree() -> bool:
        publisher.publish(effort(graph, 1.0))
        return says(graph, "plant", ERROR, "two senders of joint_command")

    graph.wait(disagree, "the plant's word")
    assert graph.says("plant", "mode", "holding")
    assert np.linalg.norm(graph.position() - at) < 0.02
    graph.node.destroy_publisher(publisher)
    graph.wait(lambda: graph.says("plant", "mode", "running"), "the end of the disagreement")
    assert int(graph.health["/plant"].values["conflicting_commands"]) > 0
    assert_held(graph)
    far = distance(graph)
    graph.wait(lambda: distance(graph) < 0.8 * far, "the way to p_d")
