# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) on random grasps of three to five contacts, against trying every case."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.exact import best_forces
from support.grasps import balance_in_frames, grasps, moved, rotations, vectors

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig

weights = st.lists(st.floats(0.5, 20.0), min_size=3, max_size=3)


def optimizer(contacts, values, least=0.0):
    config = ForceOptimizerConfig(weights=values, minimum_normal=least)
    return ForceOptimizer(config, len(contacts.positions))


@settings(max_examples=150)
@given(grasps(), weights, st.sampled_from([0.0, 0.0, 0.05]))
def test_agrees_with_trying_every_set_of_active_bounds(contacts, values, least):
    expected = best_forces(contacts, np.tile(values, len(contacts.positions)), least)
    # Beyond this the grasp hardly balances at all, and no method knows whether it does.
    assume(expected is not None and np.abs(expected).max() < 100.0)
    found = optimizer(contacts, values, least).solve(contacts)
    assert found.ok, found.reason
    assert found.residual < 1e-9
    np.testing.assert_allclose(found.forces, expected, atol=1e-7 * np.abs(expected).max())


@settings(max_examples=100)
@given(grasps(), weights)
def test_what_is_called_solved_satisfies_the_constraints(contacts, values):
    found = optimizer(contacts, values).solve(contacts)
    assume(found.ok)
    size = max(1.0, np.abs(found.forces).max())
    assert np.abs(balance_in_frames(contacts) @ found.forces.ravel()).max() < 1e-8 * size
    assert abs(found.forces[:, 1].sum() - 1.0) < 1e-8
    assert found.forces[:, 1].min() > -1e-8 * size


@settings(max_examples=50)
@given(grasps(most=4), weights, rotations, vectors, st.floats(0.2, 5.0))
def test_does_not_depend_on_place_direction_or_size(contacts, values, rotation, shift, scale):
    """One solver, warm-started from the first answer, must give the second grasp the same."""
    solver = optimizer(contacts, values)
    first = solver.solve(contacts)
    assume(first.ok and np.abs(first.forces).max() < 100.0)
    there = moved(Contacts(scale * contacts.positions, contacts.rotations), rotation, shift)
    second = solver.solve(there)
    assert second.ok, second.reason
    np.testing.assert_allclose(second.forces, first.forces, atol=1e-7 * np.abs(first.forces).max())
