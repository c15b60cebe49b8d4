# SPDX-License-Identifier: Apache-2.0
"""Thin plates, whose normals hardly balance: what a linear program can balance, (13) must solve."""

from collections import Counter

import numpy as np
from scipy.optimize import linprog
from support.grasps import balance_in_frames, contacts_at

from tactile_hand_ros.control.grasp import collinearity_margin
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    Status,
)


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


def least_forces(contacts):
    """Return the least largest |force| that balances with a squeeze of 1, infinite for none."""
    balance = balance_in_frames(contacts)
    balance[3:] /= np.abs(contacts.positions - contacts.positions.mean(axis=0)).max()
    k = len(contacts.positions)
    bounds = [(-1.0, 1.0), (0.0, 1.0), (-1.0, 1.0)] * k
    squeeze = np.tile([0.0, 1.0, 0.0], k)
    found = linprog(-squeeze, A_eq=balance, b_eq=np.zeros(6), bounds=bounds)
    assert found.status == 0
    return 1.0 / -found.fun if found.fun < -1e-9 else np.inf


def outcomes(number, solver="exact"):
    """Count how (13) ends for plates whose least forces are 30 to 1,000 times the squeeze."""
    random, counts, optimizers = np.random.default_rng(3), Counter(), {}
    while sum(counts.values()) < number:
        grasp = random_plate(random)
        if not 30.0 < least_forces(grasp) < 1e3:
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
