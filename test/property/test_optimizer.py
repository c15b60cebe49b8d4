# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) on random grasps against trying every case, and on thin plates."""

from collections import Counter

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from support.exact import best_forces
from support.grasps import balance_in_frames, contacts_at, grasps, moved, rotations, vectors

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import collinearity_margin
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    Status,
)

weights = st.lists(st.floats(0.5, 20.0), min_size=15, max_size=15)  # of up to five contacts


def optimizer(contacts, values, minimum=0.0):
    k = len(contacts.positions)
    config = ForceOptimizerConfig(weights=values[: 3 * k], minimum_normal=minimum)
    return ForceOptimizer(config, k)


@settings(max_examples=150)
@given(grasps(), weights, st.sampled_from([0.0, 0.0, 0.05]))
def test_agrees_with_trying_every_set_of_active_bounds(contacts, values, minimum):
    expected = best_forces(contacts, np.array(values[: contacts.positions.size]), minimum)
    # Beyond this the grasp hardly balances at all, and no method knows whether it does.
    assume(expected is not None and np.abs(expected).max() < 100.0)
    found = optimizer(contacts, values, minimum).solve(contacts)
    assert found.ok, found.reason
    assert found.residual < 1e-9
    np.testing.assert_allclose(found.forces, expected, atol=1e-7 * np.abs(expected).max())


@settings(max_examples=50)
@given(grasps(maximum=4), weights, rotations, vectors, st.floats(0.2, 5.0))
def test_does_not_depend_on_place_direction_or_size(contacts, values, rotation, shift, scale):
    """One solver, warm-started from the first answer, must give the second grasp the same."""
    solver = optimizer(contacts, values)
    first = solver.solve(contacts)
    assume(first.ok and np.abs(first.forces).max() < 100.0)
    there = moved(Contacts(scale * contacts.positions, contacts.rotations), rotation, shift)
    second = solver.solve(there)
    assert second.ok, second.reason
    np.testing.assert_allclose(second.forces, first.forces, atol=1e-7 * np.abs(first.forces).max())


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


def smallest_forces(contacts):
    """Return the minimum of the largest |force| for a grasp force of 1, infinite for none."""
    balance = balance_in_frames(contacts)
    balance[3:] /= np.abs(contacts.positions - contacts.positions.mean(axis=0)).max()
    k = len(contacts.positions)
    bounds = [(-1.0, 1.0), (0.0, 1.0), (-1.0, 1.0)] * k
    pushes = np.tile([0.0, 1.0, 0.0], k)
    found = linprog(-pushes, A_eq=balance, b_eq=np.zeros(6), bounds=bounds)
    assert found.status == 0
    return 1.0 / -found.fun if found.fun < -1e-9 else np.inf


def outcomes(number, solver="exact"):
    """Count how (13) ends for plates whose minimum forces are 30 to 1,000 times the grasp force."""
    random, counts, optimizers = np.random.default_rng(3), Counter(), {}
    while sum(counts.values()) < number:
        grasp = random_plate(random)
        if not 30.0 < smallest_forces(grasp) < 1e3:
            continue
        k = len(grasp.positions)
        chosen = optimizers.setdefault(k, ForceOptimizer(ForceOptimizerConfig(solver=solver), k))
        found = chosen.solve(grasp)
        counts[found.status] += 1
        assert not found.ok or found.residual < 1e-8
    return counts


def test_what_balances_is_solved():
    for solver in ("exact", "osqp"):
        assert outcomes(40, solver) == {Status.SOLVED: 40}
