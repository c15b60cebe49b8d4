# SPDX-License-Identifier: Apache-2.0
"""The minimum grasp force: cases to compute by hand, and bounds from random forces."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.grasps import contacts_at

from studies.slip.minimum import SIDES, minimum_grasp_force
from tactile_hand_ros.control.grasp import net_wrench

EXACT = 1.0 / math.cos(math.pi / SIDES)  # how much a pyramid may ask for above a cone
OPPOSED = contacts_at(
    [[0.1, 0.02, 0.0], [0.1, -0.02, 0.0], [-0.1, 0.0, 0.0]],
    [[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
)


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
def test_a_weight_between_opposed_fingers_needs_weight_over_mu(mu):
    """Each side carries what friction allows, so that mu sum f_n = weight."""
    lift = np.array([0.0, 0.0, 2.0])
    # The weight hangs midway between the sides; the centroid of three contacts lies elsewhere.
    torque = np.cross(-OPPOSED.centroid, lift)
    force = minimum_grasp_force(OPPOSED, np.concatenate([lift, torque]), mu)
    assert 2.0 / mu * (1 - 1e-9) <= force <= 2.0 / mu * EXACT


@pytest.mark.parametrize(
    ("force", "mu", "needed"),
    [([3.0, 0.0, 0.0], 0.0, 3.0), ([0.0, 0.0, 1.0], 0.0, math.inf), ([0.0] * 3, 0.5, 0.0)],
)
def test_only_what_acts_along_the_normals_is_carried_without_friction(force, mu, needed):
    found = minimum_grasp_force(OPPOSED, np.array([*force, 0.0, 0.0, 0.0]), mu)
    assert found == pytest.approx(needed, rel=1e-9, abs=1e-9)


def test_a_lost_contact_carries_nothing():
    """Two fingers on one side cannot hold."""
    lost = OPPOSED.without(np.arange(3) == 2)
    assert math.isinf(minimum_grasp_force(lost, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 0.5))


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), mu=st.floats(0.1, 1.5))
def test_no_more_than_any_forces_inside_the_cones(seed, mu):
    """Forces inside the cones carry their own wrench, so the minimum is not above theirs."""
    random = np.random.default_rng(seed)
    contacts = contacts_at(*random.normal(size=(2, 3, 3)))
    normal, angle = random.uniform(0.1, 5.0, 3), random.uniform(0.0, 2.0 * np.pi, 3)
    side = mu * normal * random.uniform(0.0, 1.0, 3)
    forces = np.stack([side * np.cos(angle), normal, side * np.sin(angle)], axis=1)
    wrench = net_wrench(contacts.positions, contacts.rotations, forces)
    minimum = minimum_grasp_force(contacts, wrench, mu)
    assert 0.0 <= minimum <= normal.sum() * EXACT * (1 + 1e-9)
