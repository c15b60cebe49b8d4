# SPDX-License-Identifier: Apache-2.0
"""What a grasp can survive: against loads whose minimum grasp force is known by hand."""

import pytest
from support.outcomes import run_scenario, survival

from tactile_hand_ros.scenario.scenario import load_scenario

PULL = {"kind": "step", "start": 0.1, "force": [0.0, 0.0, -10.0]}


def judged(changes):
    changes = {"duration": 0.2, "targets": [], **changes}
    return survival(run_scenario("gravity", changes), load_scenario("gravity", changes))


def test_weight_needs_friction():
    """0.2 kg with mu = 0.6 on faces that stand upright: m g / mu."""
    found = judged({})
    assert found.worst == pytest.approx(0.2 * 9.81 / 0.6, rel=0.02)
    assert found.limit == 60.0 and found.possible


def test_the_worst_instant_counts_and_a_limit_below_it_is_no_hope():
    changes = {"plant.disturbances": [PULL], "slip_regulator.grasp_force": 10.0}
    found = judged(changes)
    assert found.worst == pytest.approx((0.2 * 9.81 + 10.0) / 0.6, rel=0.02)
    assert found.time >= 0.1 and found.possible
    assert not judged({**changes, "slip_regulator.maximum": 15.0}).possible


def test_friction_that_falls_counts():
    found = judged({"plant.friction_changes": [{"start": 0.1, "friction": 0.3}]})
    assert found.worst == pytest.approx(0.2 * 9.81 / 0.3, rel=0.02)
