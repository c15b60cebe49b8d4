# SPDX-License-Identifier: Apache-2.0
"""Whatever node dies, the object stays in the hand, the others say so, and the run goes on."""

import signal
from collections.abc import Iterator

import numpy as np
import pytest
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
