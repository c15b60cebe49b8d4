# SPDX-License-Identifier: Apache-2.0
"""A strictly convex problem with many inequalities, few of them active, solved exactly.

    min x^T W x + q^T x   s.t.  E x = e,  R x <= b

The dual method of Goldfarb and Idnani (1983): from an optimum under some inequalities, the one that
it violates most is let in, and those whose multipliers reach zero on the way are let go. It begins
with the inequalities that were active in the last tick, so that it takes one linear system nearly
always. All systems are small: their matrices are factorized again, keeping rounding errors from
adding up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]


@compiled
def least_cost(
    rows: Array, right: Array, weights: Array, price: Array, x: Array
) -> tuple[Array, bool]:
    """Fill in the optimum; return its multipliers y, and whether both are determined.

    Args:
        rows: A, shape (m, n).
        right: b, shape (m,).
        weights: Diagonal of W, shape (n,).
        price: q, shape (n,).
        x: f, shape (n,).
    """
    size, n = rows.shape
    multipliers = np.zeros(size)
    factor, determined = factorize(schur_complement(rows, weights))
    if not determined:
        return multipliers, False
    missing = _missing(rows, right, weights, price, multipliers, x)
    for _ in range(2):  # the second time removes the rounding errors of the first
        missing *= -2.0
        substitute(factor, missing.reshape(size, 1))
        multipliers += missing
        missing = _missing(rows, right, weights, price, multipliers, x)
    return multipliers, True


@compiled
def _missing(
    rows: Array, right: Array, weights: Array, price: Array, multipliers: Array, x: Array
) -> Array:
    """Fill in the f that belongs to multipliers; return by how much it misses b, shape (m,)."""
    size, n = rows.shape
    for j in range(n):
        total = price[j]
        for i in range(size):
            total += rows[i, j] * multipliers[i]
        x[j] = -0.5 * total / weights[j]
    missing = right.copy()
    for i in range(size):
        for j in range(n):
            missing[i] -= rows[i, j] * x[j]
    return missing


@compiled
def schur_complement(rows: Array, weights: Array) -> Array:
    """Return A W^-1 A^T, of which the upper triangle is filled in."""
    size, n = rows.shape
    out = np.zeros((size, size))
    for i in range(size):
        for j in range(i, size):
            total = 0.0
            for c in range(n):
                total += rows[i, c] * rows[j, c] / weights[c]
            out[i, j] = total
    return out


Flags = NDArray[np.bool_]

_ROUNDING = 1e-12  # per largest unknown or multiplier above 1: no reason to exchange an inequality
_DEPENDENT = 1e-13  # share of a row that is left when it depends on the active ones
_MAX_SYSTEMS = 100


class Problem(NamedTuple):
    """The numbers of a problem with n unknowns.

    Attributes:
        weights: Diagonal of W, shape (n,).
        price: q, shape (n,).
        equal: E, shape (e, n).
        right: e, shape (e,).
        rows: R, shape (m, n).
        bounds: b, shape (m,).
    """

    weights: Array
    price: Array
    equal: Array
    right: Array
    rows: Array
    bounds: Array


@compiled
def solve_problem(problem: Problem, held: Flags) -> tuple[Array, Array, int]:
    """Return the optimum and the number of linear systems that it took.

    Args:
        problem: The problem.
        held: Inequalities to begin with as active, shape (m,); becomes those that are.

    Returns:
        The unknowns, shape (n,), and the multipliers of equations and inequalities, shape (e + m,),
        of no use where the number is 0: then there is no answer, or the inequalities do not settle.
    """
    e, systems = len(problem.equal), 0
    x, multipliers = np.zeros(len(problem.price)), np.zeros(e + len(held))
    y = multipliers[e:]
    while systems < _MAX_SYSTEMS:
        systems += 1
        if not _optimum(problem, held, x, multipliers):
            if not held.any():
                break
            held[:] = False  # so many leave nothing free; start again without
            continue
        pulling = int(np.argmin(y))
        if y[pulling] < -_ROUNDING * max(1.0, np.abs(y).max()):
            held[pulling] = False
            continue
        excess = problem.rows @ x - problem.bounds
        excess[held] = 0.0
        worst = int(np.argmax(excess))
        if not excess[worst] > _ROUNDING * max(1.0, np.abs(x).max()):
            return x, multipliers, systems
        taken = _let_in(problem, held, worst, excess[worst], y)
        systems += taken
        if not taken:
            break
    held[:] = False
    return x, multipliers, 0


@compiled
def violation(problem: Problem, x: Array, multipliers: Array) -> float:
    """Return the largest violation of the constraints and of the stationarity of the Lagrangian.

    Args:
        problem: The problem.
        x: The unknowns, shape (n,).
        multipliers: Of equations and inequalities, shape (e + m,).
    """
    e, worst = len(problem.equal), 0.0
    slopes = 2.0 * problem.weights * x + problem.price
    for i in range(len(multipliers)):
        row = problem.equal[i] if i < e else problem.rows[i - e]
        excess = -(problem.right[i] if i < e else problem.bounds[i - e])
        for j in range(len(x)):
            excess += row[j] * x[j]
            slopes[j] += row[j] * multipliers[i]
        worst = max(worst, abs(excess) if i < e else excess)
    steepest: float = np.abs(slopes).max()
    return max(worst, steepest)


@compiled
def _optimum(problem: Problem, held: Flags, x: Array, multipliers: Array) -> bool:
    """Fill in the optimum under active inequalities; return whether it is determined."""
    e = len(problem.equal)
    rows, right = _active(problem, held)
    found, determined = least_cost(rows, right, problem.weights, problem.price, x)
    multipliers[:] = 0.0
    multipliers[:e] = found[:e]
    multipliers[e:][held] = found[e:]
    return determined


@compiled
def _active(problem: Problem, held: Flags) -> tuple[Array, Array]:
    """Return the rows that hold as equations, and their right sides."""
    chosen = np.flatnonzero(held)
    e, n = problem.equal.shape
    rows, right = np.empty((e + len(chosen), n)), np.empty(e + len(chosen))
    rows[:e], right[:e] = problem.equal, problem.right
    for i in range(len(chosen)):
        rows[e + i], right[e + i] = problem.rows[chosen[i]], problem.bounds[chosen[i]]
    return rows, right


@compiled
def _let_in(problem: Problem, held: Flags, entering: int, excess: float, y: Array) -> int:
    """Make a violated inequality active; return how many systems that took, 0 if it cannot be.

    Its multiplier grows until it holds. An active one whose multiplier has come to zero before is
    let go.

    Args:
        problem: The problem.
        held: The active inequalities, shape (m,); brought up to date.
        entering: The violated one.
        excess: By how much.
        y: Multipliers, shape (m,), none of them negative but for rounding; brought up to date.
    """
    for systems in range(1, _MAX_SYSTEMS):
        fall, gain = _direction(problem, held, problem.rows[entering])
        step, leaving = excess / gain if gain > 0.0 else np.inf, -1
        for j in range(len(held)):
            if held[j] and fall[j] > 0.0 and y[j] < step * fall[j]:
                step, leaving = max(y[j], 0.0) / fall[j], j
        if step == np.inf:
            return 0
        y -= step * fall
        if leaving < 0:
            held[entering] = True
            return systems
        held[leaving], y[leaving] = False, 0.0
        excess -= step * gain
    return 0


@compiled
def _direction(problem: Problem, held: Flags, row: Array) -> tuple[Array, float]:
    """Return what becomes of the optimum as the multiplier of another row grows by one.

    Returns:
        By how much the active inequalities' multipliers fall, shape (m,), and by how much the
        optimum goes back from beyond the row's bound, 0 where the active rows do not let it move.
    """
    rows, _ = _active(problem, held)
    size, e, weights = len(rows), len(problem.equal), problem.weights
    factor, determined = factorize(schur_complement(rows, weights))
    fall = np.zeros(len(held))
    if not determined:
        return fall, 0.0
    shares = np.zeros(size)
    for i in range(size):
        for j in range(len(row)):
            shares[i] += rows[i, j] * row[j] / weights[j]
    substitute(factor, shares.reshape(size, 1))
    fall[held] = shares[e:]
    gain, whole = 0.0, 0.0
    for j in range(len(row)):
        left = row[j]
        for i in range(size):
            left -= rows[i, j] * shares[i]
        gain += 0.5 * left * left / weights[j]
        whole += 0.5 * row[j] * row[j] / weights[j]
    return fall, gain if gain > _DEPENDENT * whole else 0.0
