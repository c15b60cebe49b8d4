# SPDX-License-Identifier: Apache-2.0
"""What the paper claims, end to end in-process: where it holds, where in part, where not."""

import functools

import numpy as np
import pytest

from tactile_hand_ros.reproduce.claims import (
    LAYOUTS,
    ExperimentRun,
    run_experiment,
    translational_stiffness,
)
from tactile_hand_ros.run import derived
from tactile_hand_ros.scenario.scenario import load_scenario

LAWS = ("optimal", "contact", "kawamura")
# Duration of each experiment [s]; None is that of the scenario.
SECONDS = {"optimal": None, "nominal": 10.0, "firm": 4.0, "contact": 4.0, "kawamura": 3.5}
SECONDS |= {f"hold_{law}": 2.0 for law in LAWS}

run_once = functools.cache(run_experiment)


def outcome(key: str, layout: str = "three_faces") -> ExperimentRun:
    return run_once(key, layout, SECONDS[key])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_desired_state_and_forces_are_reached_and_no_contact_is_lost(layout):
    """Fig. 3, equation (15)."""
    run = outcome("optimal", layout)
    m = run.metrics
    assert m.goal_reached and m.contacts_lost_ticks == 0
    assert m.final_position_error_m < 1e-4 and m.final_rotation_error_rad < 1e-4
    assert np.abs(run.record.rates[-1]).max() < 1e-3
    assert 0.2 < m.peak_joint_rate_rad_per_s < 1.0 and m.peak_normal_force_N < 6.0
    assert m.worst_normal_force_relative_error < 1e-3
    assert m.normal_force_sum_N == pytest.approx(10.0, rel=1e-4)
    half = 0.5 * np.array(run.scenario.plant.object.size)
    assert derived.rolling(run.record).max() < half.min()  # the contacts began at face centres


@pytest.mark.parametrize(
    ("layout", "key"),
    [("three_faces", "nominal"), ("three_faces", "firm"), ("three_faces", "contact")]
    + [("pinch", "nominal")],
)
def test_the_grasp_force_does_no_work(layout, key):
    """Other W, twice k_f, or (10) for (14): other forces, the same motion to 2 um of 190 mm."""
    other = outcome(key, layout).record
    one = outcome("optimal", layout).record.part(slice(len(other)))
    path = np.linalg.norm(one.auxiliary_position - other.auxiliary_position, axis=1)
    assert path.max() < 2e-6
    assert np.abs(derived.rotation_error(one) - derived.rotation_error(other)).max() < 1e-4
    assert np.abs(one.forces - other.forces).max() > 0.01


def test_penalising_tangential_forces_helps_two_fingers_and_loads_the_third():
    """Fig. 4 in the layout three_faces: the third finger and the grasp as a whole need more."""
    penalised = outcome("optimal").metrics.final_required_friction
    nominal = outcome("nominal").metrics.final_required_friction
    assert penalised["finger_1"] < 0.6 * nominal["finger_1"]
    assert penalised["finger_2"] < 0.6 * nominal["finger_2"]
    assert penalised["finger_3"] > 1.5 * nominal["finger_3"]
    assert max(penalised.values()) > max(nominal.values())


def test_penalising_tangential_forces_helps_every_finger_of_a_pinch():
    """Fig. 4 in the layout pinch, by one to three percent."""
    penalised = outcome("optimal", "pinch").metrics.final_required_friction
    nominal = outcome("nominal", "pinch").metrics.final_required_friction
    for finger, beta in penalised.items():
        assert 0.97 < beta / nominal[finger] < 0.99


def test_squeezing_through_fingertips_rolls_and_through_contacts_does_not():
    """Section III: the same grasp, held where it is for two seconds."""
    rolled = {law: derived.rolling(outcome(f"hold_{law}").record).max() for law in LAWS}
    assert rolled["kawamura"] > 0.02
    assert max(rolled["contact"], rolled["optimal"]) < 1e-9


def test_kawamuras_law_loses_the_object_on_the_way():
    m = outcome("kawamura").metrics
    assert m.contacts_lost_ticks > 0 and not m.goal_reached
    assert 2.0 < m.first_contact_loss_s < 3.5


def test_kawamuras_law_starts_with_the_forces_of_theorem_1():
    """f_n,i = d_i k_f / sum(r), before anything rolls; d_i from the tips' centroid."""
    record = outcome("kawamura").record
    distances = np.array([0.1902, 0.1902, 0.1902 - 0.1902 / 3.0])
    np.testing.assert_allclose(record.forces[1, :, 1], 10.0 * distances / 0.18, rtol=0.02)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    ("name", "at", "expected"), [("kawamura", "tips", 9.0), ("paper", "contacts", 3.0)]
)
def test_kawamuras_law_pulls_once_a_finger(layout, name, at, expected):
    """Its translational stiffness is k times k_p, that of (14) is k_p."""
    stiffness = translational_stiffness(load_scenario(name, {"layout": layout}), at)
    np.testing.assert_allclose(stiffness, expected * np.eye(3), atol=1e-9)
