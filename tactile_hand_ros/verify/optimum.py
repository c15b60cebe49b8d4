# SPDX-License-Identifier: Apache-2.0
"""Optimality of recorded f*: (13) solved again for all ticks at once, by other means than OSQP.

Without cones the optimum is found by trying the sets of bounds that may be active, each of which
gives a linear system. With cones it is the solution of a least-distance problem, by non-negative
least squares (Lawson and Hanson 1974), and f* goes its way there from the f* of the tick before.

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


def imbalance(problem: Problem, forces: Array) -> Array:
    """Return the largest of |G~ f*| and |sum f_n - 1| at all ticks, shape (n,)."""
    image = (problem.equal @ forces[:, :, None])[:, :, 0]
    image[:, 6] -= 1.0
    return np.asarray(np.abs(image).max(axis=1, initial=0.0))


@dataclass(frozen=True)
class Pyramids:
    """Friction pyramids of k contacts at one tick, and what it costs to leave them.

    Attributes:
        friction: mu of each contact, shape (k,).
        bounds: How far f* must stay inside each side, shape (k, sides).
        penalty: Cost of leaving them, per largest weight.
    """

    friction: Array
    bounds: Array
    penalty: float

    @property
    def sides(self) -> int:
        """Number of sides."""
        return int(self.bounds.shape[1])

    @classmethod
    def about(cls, friction: Array, load: Array, sides: int, penalty: float) -> Pyramids:
        """Return the pyramids that hold f* and a load per unit of squeeze, shape (k, 3)."""
        free = cls(friction, np.zeros((len(friction), sides)), penalty)
        return cls(friction, free.beyond(load), penalty)

    def beyond(self, forces: Array) -> Array:
        """Return how far forces, shape (k, 3), reach beyond each side, shape (k, sides)."""
        return (self.rows()[0] @ forces.ravel()).reshape(-1, self.sides)

    def rows(self) -> tuple[Array, Array]:
        """Return A and b of A f <= b + t, shapes (k sides, 3k) and (k sides,)."""
        k = len(self.friction)
        angles = 2.0 * np.pi * np.arange(self.sides) / self.sides
        slope = np.cos(np.pi / self.sides) * self.friction
        rows = np.zeros((k, self.sides, k, 3))
        for i in range(k):
            rows[i, :, i] = np.array([np.cos(angles), -slope[i] + 0.0 * angles, np.sin(angles)]).T
        flat = rows.reshape(k * self.sides, 3 * k)
        return flat, -self.bounds.ravel()

    def excess(self, forces: Array) -> float:
        """Return how far f*, shape (3k,), is outside; negative inside."""
        rows, bound = self.rows()
        return float((rows @ forces - bound).max())


def solve_inside(equal: Array, weights: Array, minimum: float, p: Pyramids) -> Array:
    """Return f* of (13) inside friction pyramids at one tick, shape (3k,).

    With t, the largest violation of the pyramids, w f^2 / max w + rho t + t^2 is a distance.
    The rows of `equal` leave few directions. What remains is least-distance programming: the
    smallest z with A z >= b, which follows from non-negative least squares.

    Source: Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23.
    """
    size = len(weights)
    rows, bound = p.rows()
    outer = np.hstack([-rows, np.ones((len(rows), 1))])
    inner = np.eye(size + 1)[[*range(1, size, 3), size]]
    above = np.vstack([outer, inner])
    least = np.concatenate([-bound, np.full(size // 3, minimum), [0.0]])
    scale = np.sqrt(np.append(weights / weights.max(), 1.0))
    centre = np.append(np.zeros(size), -0.5 * p.penalty)
    fixed = np.hstack([equal, np.zeros((len(equal), 1))])
    right = np.append(np.zeros(len(equal) - 1), 1.0)
    u, values, vt = np.linalg.svd(fixed / scale)
    rank = int((values > _ROUNDING * values[0]).sum())
    free = vt[rank:].T
    at = vt[:rank].T @ ((u[:, :rank].T @ (right - fixed @ centre)) / values[:rank])
    # x = centre + (at + free z) / scale, and the cost is |at|^2 + |z|^2.
    a, b = (above / scale) @ free, least - above @ (centre + at / scale)
    columns = np.vstack([a.T, b])
    unit = np.append(np.zeros(len(columns) - 1), 1.0)
    residual = columns @ nnls(columns, unit)[0] - unit
    z = -residual[:-1] / residual[-1]
    return np.asarray((centre + (at + free @ z) / scale)[:size])


def follow(before: Array, goal: Array, equal: Array, learned: Pyramids, share: float) -> Array:
    """Return f* a share of the way from that of the last tick to an optimum, shape (3k,).

    It begins at the nearest forces in balance and goes at least as far as it takes to be inside the
    pyramids of the learned friction.
    """
    right = np.append(np.zeros(len(equal) - 1), 1.0)
    start = before + np.linalg.pinv(equal) @ (right - equal @ before)
    rows, bound = learned.rows()
    first, last = rows @ start - bound, rows @ goal - bound
    outside = first > 0.0
    if (last[outside] >= 0.0).any():
        return goal
    ways = first[outside] / (first[outside] - last[outside])
    return np.asarray(start + max(share, ways.max(initial=0.0)) * (goal - start))
