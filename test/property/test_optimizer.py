# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) on random grasps against trying every case, and on thin plates."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.exact import best_forces
from support.grasps import contacts_at, grasps

from tactile_hand_ros.control.grasp import collinearity_margin
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig

weights = st.lists(st.floats(0.5, 20.0), min_size=15, max_size=15)  # of up to five contacts


@settings(max_examples=150)
@given(grasps(), weights, st.sampled_from([0.0, 0.0, 0.05]))
def test_agrees_with_trying_every_set_of_active_bounds(contacts, values, minimum):
    values = values[: contacts.positions.size]
    expected = best_forces(contacts, np.array(values), minimum)
    # Beyond this the grasp hardly balances at all, and no method knows whether it does.
    assume(expected is not None and np.abs(expected).max() < 100.0)
    config = ForceOptimizerConfig(weights=values, minimum_normal=minimum)
    found = ForceOptimizer(config, len(contacts.positions)).solve(contacts)
    assert found.ok, found.reason
    assert found.residual < 1e-9
    np.testing.assert_allclose(found.forces, expected, atol=1e-7 * np.abs(expected).max())


def random_plate(random):
    """Return a grasp of three to five fingers on the two sides of a plate, hardly tilted."""
    k = int(random.integers(3, 6))
    while True:
        points = random.uniform(-0.1, 0.1, (k, 3)) * [1.0, 1.0, 10.0 ** random.uniform(-3.0, 0.0)]
        if collinearity_margin(points) > 0.01:
            break
    normals = np.outer(random.choice([-1.0, 1.0], k), [0.0, 0.0, 1.0])
    normals += 10.0 ** random.uniform(-3.0, -0.5) * random.standard_normal((k, 3))
    return contacts_at(points, normals)


@pytest.mark.parametrize("solver", ["exact", "osqp"])
def test_what_balances_is_solved(solver):
    """Also on plates whose forces are 30 to 1,000 times the grasp force."""
    config, random, solved = ForceOptimizerConfig(solver=solver), np.random.default_rng(3), 0
    optimizers = {k: ForceOptimizer(config, k) for k in (3, 4, 5)}
    while solved < 40:
        grasp = random_plate(random)
        k = len(grasp.positions)
        expected = best_forces(grasp, np.tile([10.0, 1.0, 10.0], k))
        if expected is not None and 30.0 < np.abs(expected).max() < 1e3:
            found = optimizers[k].solve(grasp)
            assert found.ok and found.residual < 1e-8
            solved += 1
