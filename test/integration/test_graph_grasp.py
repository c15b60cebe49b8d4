# SPDX-License-Identifier: Apache-2.0
"""The hand lets go of the object and takes it again when asked to, across processes."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator

import numpy as np
import pytest
from std_srvs.srv import SetBool
from support.graph import Graph

from tactile_hand_ros.ros.diagnostics import OK, WARN
from tactile_hand_ros.ros.middleware import isolated_domain
from tactile_hand_ros.scenario.scenario import load_scenario

# Weightless, so that the cube waits where it was let go.
WORLD = {
    "duration": 86400.0,
    "targets": [],
    "plant.autostart": False,
    "plant.object.mass": 0.2,
    "plant.object.friction": 1.0,
}
MARGINS = {
    "manipulation_controller": (
        "A1 face_travel_m",
        "A2 hemisphere_margin_rad",
        "A5 joint_singularity_margin_m_per_rad",
        "A7 collinearity_margin",
    ),
    "slip_regulator": ("A3 load_n", "A4 slip_margin", "A4 cone_margin_n", "A6 slip_time_left_s"),
    "force_optimizer": ("residual",),
}


@pytest.fixture
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """Hold a cube that weighs nothing."""
    folder = tmp_path_factory.mktemp("graph")
    scenario = load_scenario("paper", WORLD)
    with isolated_domain() as domain, Graph(scenario, domain, folder) as started:
        started.begin()
        started.wait(lambda: started.time > 0.5, "a grasp")
        yield started
        assert set(started.end(signal.SIGINT).values()) == {0}


def says(graph: Graph, level: bytes) -> bool:
    health = graph.health.get(graph.full("manipulation_controller"))
    return health is not None and health.level == level


def values(graph: Graph) -> dict[str, float]:
    """Return every margin that has been told so far."""
    found = {}
    for name, keys in MARGINS.items():
        health = graph.health.get(graph.full(name))
        told = health.values if health is not None else {}
        found.update({key: float(told[key]) for key in keys if key in told})
    return found


def test_opens_says_so_closes_and_holds_again(graph: Graph) -> None:
    every = sum(MARGINS.values(), ())
    graph.wait(
        # Of a contact that has just been made nothing is known yet.
        lambda: set(every) == {key for key, value in values(graph).items() if math.isfinite(value)},
        "a margin of each assumption",
    )
    held = values(graph)
    assert held["A7 collinearity_margin"] > 0.5 and held["A2 hemisphere_margin_rad"] > 0.5
    assert held["A5 joint_singularity_margin_m_per_rad"] > 0.01
    assert 0.0 < held["A4 slip_margin"] <= 1.0 and held["A6 slip_time_left_s"] > 0.0
    at = graph.position()

    answer = graph.call(SetBool, "manipulation_controller/grasp", SetBool.Request(data=False))
    assert answer.success and answer.message == "opening"
    graph.wait(lambda: np.isnan(graph.contacts).all(), "all fingers to leave")
    graph.wait(lambda: graph.says("manipulation_controller", "mode", "open"), "its word")
    assert says(graph, WARN)
    # A7 is broken and the ledger says so.
    graph.wait(lambda: values(graph)["A7 collinearity_margin"] == 0.0, "a breach of A7")
    assert np.linalg.norm(graph.position() - at) < 0.02

    answer = graph.call(SetBool, "manipulation_controller/grasp", SetBool.Request(data=True))
    assert answer.success and answer.message == "closing"
    graph.wait(lambda: graph.says("manipulation_controller", "mode", "drive"), "a new grasp")
    until = graph.time + 1.0
    graph.wait(lambda: graph.time > until, "the grasp to settle")
    assert np.isfinite(graph.contacts).all()
    np.testing.assert_allclose(graph.forces[:, 1].sum(), graph.grasp_force, rtol=0.05)
    graph.wait(lambda: says(graph, OK), "all to be well")
