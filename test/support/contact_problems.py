# SPDX-License-Identifier: Apache-2.0
"""Random contact problems of three kinds, and a judge of their solutions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from support.exact import contact_law_violation
from tactile_hand_ros.simulation.coulomb import EXACT, RELAXED, solve_contacts

Array = NDArray[np.float64]

KINDS = ("regular", "redundant", "singular")
FRICTION = (0.0, 0.1, 0.5, 1.0, 1.5, 2.0, 5.0, 20.0, 100.0)


class Problem(NamedTuple):
    """A contact problem w = W p + b with W = A M^-1 A^T and b = A v.

    Attributes:
        kind: regular (A of full row rank), redundant (more rows than velocities) or singular
            (contacts that repeat, oppose or cannot move).
        delassus: W, shape (3k, 3k), 1/kg.
        free: b, shape (3k,), m/s.
        closing: gap / h, shape (k,), m/s; negative in one problem of eight.
        friction: mu, shape (k,).
        rows: A M^-1/2, shape (3k, n).
    """

    kind: str
    delassus: Array
    free: Array
    closing: Array
    friction: Array
    rows: Array


def random_problem(seed: int) -> Problem:
    """Return a problem of one to six contacts, the same for the same seed."""
    random = np.random.default_rng(seed)
    kind = KINDS[seed % 3]
    k = int(random.integers(1, 7))
    n = 3 * k
    if kind == "regular":
        columns = n + int(random.integers(0, 7))
    else:
        columns = int(random.integers(1, n)) if kind == "redundant" else max(3, n - 1)
    rows = random.standard_normal((n, columns)) * 10.0 ** random.uniform(-1.0, 1.0, columns)
    if kind == "singular":
        _degenerate(rows, random)
    free = rows @ random.standard_normal(columns) * 10.0 ** random.uniform(-2.0, 1.0)
    signs = [0.0, 0.0, 1.0, -1.0] if random.random() < 0.15 else [0.0, 1.0]
    closing = random.choice(signs, k) * random.uniform(0.0, 0.5, k) * np.abs(free).max()
    alike = random.random() < 0.5
    friction = np.full(k, random.choice(FRICTION)) if alike else random.choice(FRICTION, k)
    return Problem(kind, rows @ rows.T, free, closing, friction, rows)


def _degenerate(rows: Array, random: np.random.Generator) -> None:
    """Let one contact repeat or oppose another one, or be unable to move along an axis."""
    i, j = random.integers(len(rows) // 3, size=2)
    choice = random.integers(3)
    if choice == 2 or i == j:
        rows[3 * i + random.integers(3)] = 0.0
    else:
        signs = [[1.0], [-1.0], [-1.0]] if choice else [[1.0], [1.0], [1.0]]
        rows[3 * j : 3 * j + 3] = rows[3 * i : 3 * i + 3] * signs


def is_jammed(problem: Problem, sides: int = 64) -> bool:
    """Return whether fingers can press on a penetration without limit and in balance.

    Such impulses d lie in their cones, with A^T d = 0 and c . d_n < 0. Looked for are those in
    pyramids inside the cones: what is found is a proof.
    """
    k = len(problem.friction)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rays = np.zeros((3 * k, k * sides))
    for i, mu in enumerate(problem.friction):
        edges = np.array([mu * np.cos(angles), np.ones(sides), mu * np.sin(angles)])
        rays[3 * i : 3 * i + 3, sides * i : sides * (i + 1)] = edges / max(1.0, mu)
    size = float(np.abs(problem.closing).max())
    pressing = problem.closing @ rays[1::3] / size
    balance = problem.rows.T @ rays
    found = linprog(
        pressing,
        A_eq=balance / np.abs(balance).max(),
        b_eq=np.zeros(len(balance)),
        A_ub=np.ones((1, k * sides)),
        b_ub=[1.0],
    )
    return bool(found.status == 0 and found.fun < -1e-6)


def failure(problem: Problem) -> str:
    """Solve a problem and return what is wrong with the answer, empty if nothing is."""
    _, delassus, free, closing, friction, _ = problem
    solved = solve_contacts(delassus, free, closing, friction, np.zeros((len(friction), 3)))
    broken = contact_law_violation(delassus, free, closing, friction, solved.impulses)
    if solved.outcome == EXACT:
        return f"claims to be exact and breaks the laws by {broken:.1e}" if broken > 1e-8 else ""
    if solved.outcome != RELAXED:
        return f"not solved, residual {solved.residual:.1e}"
    if not solved.residual > 1e-8:
        return "relaxed although the laws hold"
    kept = np.maximum(closing, 0.0)
    broken = contact_law_violation(delassus, free, kept, friction, solved.impulses)
    if broken > 1e-8:
        return f"breaks the relaxed laws by {broken:.1e}"
    return "" if is_jammed(problem) else "relaxed although nothing is jammed"
