# SPDX-License-Identifier: Apache-2.0
"""Optimality of recorded f*: (13) solved again for all ticks at once, by other means than OSQP.

Without cones the optimum is found by trying the sets of bounds that may be active, each of which
gives a linear system. With cones the optimality conditions are checked instead: f* is optimal if
and only if non-negative multipliers of the constraints that it touches balance the gradient, which
is a non-negative least-squares problem (Lawson and Hanson 1974).

Independent on purpose, down to its own grasp map (11): a mistake in the code that the nodes run
would otherwise be made twice and look right.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ROUNDING = 1e-9
_TOUCHES = 1e-5  # distance below which a cone counts as touched


@dataclass(frozen=True)
class Problem:
    """(13) at n ticks for k contacts.

    Attributes:
        equal: Rows of balance and of the sum, shape (n, 7, 3k).
        weights: Diagonal of W, shape (3k,).
        minimum: Least f_n.
    """

    equal: Array
    weights: Array
    minimum: float

    @classmethod
    def of(cls, positions: Array, rotations: Array, weights: Array, minimum: float) -> Problem:
        """Build it from contact points (n, k, 3) and frames (n, k, 3, 3)."""
        n, k = positions.shape[:2]
        arms = positions - positions.mean(axis=1, keepdims=True)
        arms = arms / np.sqrt((arms**2).sum(axis=(1, 2)) / k)[:, None, None]
        torques = np.cross(arms[:, :, :, None], rotations, axisa=2, axisb=2, axisc=2)
        equal = np.zeros((n, 7, 3 * k))
        equal[:, :3] = rotations.transpose(0, 2, 1, 3).reshape(n, 3, 3 * k)
        equal[:, 3:6] = torques.transpose(0, 2, 1, 3).reshape(n, 3, 3 * k)
        equal[:, 6, 1::3] = 1.0
        return cls(equal, weights, minimum)

    def part(self, rows: NDArray[np.intp]) -> Problem:
        """Return some of the ticks."""
        return Problem(self.equal[rows], self.weights, self.minimum)


@dataclass(frozen=True)
class Optimum:
    """The solution of (13) and its multipliers; NaN where there is none.

    Attributes:
        forces: f*, shape (n, 3k).
        multipliers: Of balance, sum and lower bounds, shape (n, 7 + k).
    """

    forces: Array
    multipliers: Array


def solve(problem: Problem) -> Optimum:
    """Solve (13) at all ticks by enumeration of the active bounds."""
    n, _, size = problem.equal.shape
    k = size // 3
    forces, multipliers = np.full((n, size), np.nan), np.full((n, 7 + k), np.nan)
    left = np.arange(n)
    for count in range(k):
        for active in combinations(range(k), count):
            if not len(left):
                break
            found, x, y = _with_active(problem.part(left), active)
            forces[left[found]], multipliers[left[found]] = x[found], y[found]
            left = left[~found]
    return Optimum(forces, multipliers)


def _with_active(problem: Problem, active: tuple[int, ...]) -> tuple[Flags, Array, Array]:
    """Solve with some bounds active; return where the optimality conditions hold."""
    n, _, size = problem.equal.shape
    k, held = size // 3, list(active)
    bounds = np.zeros((n, len(held), size))
    bounds[:, np.arange(len(held)), 1 + 3 * np.array(held, dtype=int)] = 1.0
    rows = np.concatenate([problem.equal, bounds], axis=1)
    right = np.concatenate([np.zeros(6), [1.0], np.full(len(held), problem.minimum)])
    spread = rows / problem.weights
    schur = spread @ rows.transpose(0, 2, 1)
    y = -2.0 * (np.linalg.pinv(schur, rcond=1e-12, hermitian=True) @ right)
    x = -0.5 * (spread.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
    full = np.zeros((n, 7 + k))
    full[:, :7] = y[:, :7]
    full[:, [7 + i for i in held]] = y[:, 7:]
    met = np.abs((rows @ x[:, :, None])[:, :, 0] - right).max(axis=1) < _ROUNDING
    inside = (x[:, 1::3] >= problem.minimum - _ROUNDING).all(axis=1)
    return np.asarray(met & inside & (full[:, 7:] <= _ROUNDING).all(axis=1)), x, full


def gaps(problem: Problem, forces: Array, multipliers: Array) -> tuple[Array, Array]:
    """Judge recorded forces against independent multipliers.

    Returns:
        Largest violation of the optimality conditions, gradient per largest weight, and duality gap
        per cost, both of shape (n,).
    """
    w, y = problem.weights, multipliers
    image = (problem.equal @ forces[:, :, None])[:, :, 0]
    image[:, 6] -= 1.0
    gradient = 2.0 * w * forces + (problem.equal.transpose(0, 2, 1) @ y[:, :7, None])[:, :, 0]
    pull = gradient - 2.0 * w * forces
    gradient[:, 1::3] += y[:, 7:]
    pull[:, 1::3] += y[:, 7:]
    below = np.maximum(problem.minimum - forces[:, 1::3], 0.0)
    worst = np.max(
        [np.abs(image).max(axis=1), np.abs(gradient).max(axis=1) / w.max(), below.max(axis=1)],
        axis=0,
    )
    cost = (w * forces**2).sum(axis=1)
    dual = -0.25 * (pull**2 / w).sum(axis=1) - y[:, 6] - problem.minimum * y[:, 7:].sum(axis=1)
    return np.asarray(worst), np.asarray(np.abs(cost - dual) / cost)


@dataclass(frozen=True)
class Pyramids:
    """Friction pyramids of k contacts at one tick, and what it costs to leave them.

    Attributes:
        friction: mu of each contact, shape (k,).
        load: Load per unit of squeeze in contact frames, shape (k, 3).
        sides: Number of sides.
        penalty: Cost of leaving them, per largest weight.
    """

    friction: Array
    load: Array
    sides: int
    penalty: float

    def rows(self) -> tuple[Array, Array]:
        """Return A and b of A f <= b + t, shapes (k sides, 3k) and (k sides,)."""
        k = len(self.friction)
        angles = 2.0 * np.pi * np.arange(self.sides) / self.sides
        slope = np.cos(np.pi / self.sides) * self.friction
        rows = np.zeros((k, self.sides, k, 3))
        for i in range(k):
            rows[i, :, i] = np.array([np.cos(angles), -slope[i] + 0.0 * angles, np.sin(angles)]).T
        flat = rows.reshape(k * self.sides, 3 * k)
        return flat, -flat @ self.load.ravel()

    def excess(self, forces: Array) -> float:
        """Return how far f*, shape (3k,), is outside; negative inside."""
        rows, bound = self.rows()
        return float((rows @ forces - bound).max())


def cone_violation(equal: Array, weights: Array, minimum: float, p: Pyramids, f: Array) -> float:
    """Return how far f*, shape (3k,), is from the optimality conditions with cones.

    The largest of the violated constraints and of the gradient that no multipliers balance, with
    costs scaled to 0.3 for the largest weight as in the optimization.
    """
    scale = 0.3 / weights.max()
    rows, bound = p.rows()
    excess = rows @ f - bound
    t = max(0.0, float(excess.max()))
    size = len(f)
    gradient = np.append(2.0 * scale * weights * f, 0.3 * p.penalty + 2.0 * 0.3 * t)
    touched = [np.append(row, -1.0) for row in rows[excess > t - _TOUCHES]]
    if t < _TOUCHES:
        touched.append(np.append(np.zeros(size), -1.0))
    for i in np.flatnonzero(f[1::3] < minimum + _TOUCHES):
        touched.append(np.eye(size + 1)[1 + 3 * i] * -1.0)
    free = np.hstack([equal, np.zeros((7, 1))])
    columns = np.vstack([free, -free, *touched]).T
    residual = columns @ nnls(columns, -gradient)[0] + gradient
    image = equal @ f
    image[6] -= 1.0
    below = max(0.0, minimum - float(f[1::3].min()))
    return float(max(np.abs(residual).max(), np.abs(image).max(), below))
