# SPDX-License-Identifier: Apache-2.0
"""Random contact problems, one to six contacts, also redundant ones, with mu from 0 to 100."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from support.exact import contact_law_violation

from tactile_hand_ros.simulation.coulomb import EXACT, RELAXED, UNSOLVED, solve_contacts

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
    """

    kind: str
    delassus: Array
    free: Array
    closing: Array
    friction: Array


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
    return Problem(kind, rows @ rows.T, free, closing, friction)


def _degenerate(rows: Array, random: np.random.Generator) -> None:
    """Let one contact repeat or oppose another one, or be unable to move along an axis."""
    i, j = random.integers(len(rows) // 3, size=2)
    choice = random.integers(3)
    if choice == 2 or i == j:
        rows[3 * i + random.integers(3)] = 0.0
    else:
        signs = [[1.0], [-1.0], [-1.0]] if choice else [[1.0], [1.0], [1.0]]
        rows[3 * j : 3 * j + 3] = rows[3 * i : 3 * i + 3] * signs


def failure(problem: Problem) -> str:
    """Solve a problem and return what is wrong with the answer, empty if nothing is."""
    _, delassus, free, closing, friction = problem
    solved = solve_contacts(delassus, free, closing, friction, np.zeros((len(friction), 3)))
    p, kept = solved.impulses, closing
    if solved.outcome == RELAXED:
        kept = np.maximum(closing, 0.0)
        if not solved.residual > 1e-8:
            return "relaxed although the laws hold"
    if solved.outcome in (EXACT, RELAXED):
        broken = contact_law_violation(delassus, free, kept, friction, p)
        return f"solved, but breaks the laws by {broken:.1e}" if broken > 1e-8 else ""
    offset = free.copy()
    offset[1::3] += closing
    work = p.ravel() @ offset + 0.5 * p.ravel() @ delassus @ p.ravel()
    return f"adds the energy {work:.1e}" if work > 1e-12 * np.abs(p.ravel() * offset).max() else ""


def test_what_is_called_solved_obeys_the_laws_and_what_is_not_adds_no_energy():
    wrong = {seed: failure(random_problem(seed)) for seed in range(1000)}
    assert not {seed: reason for seed, reason in wrong.items() if reason}


def test_nearly_all_problems_are_solved():
    """But for a few whose W is singular or whose friction is that of no material."""
    unsolved = []
    for seed in range(1000):
        problem = random_problem(seed)
        guess = np.zeros((len(problem.friction), 3))
        outcome = solve_contacts(*problem[1:], guess).outcome
        unsolved += [problem] if outcome == UNSOLVED else []
    assert len(unsolved) < 20
    assert all(each.kind != "regular" or each.friction.max() > 2.0 for each in unsolved)


def test_a_penetration_between_two_fingers_that_jam_does_not_grow():
    """On opposite sides of an object that is too wide: neither can leave it, nor goes deeper."""
    facing = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 2.0, 1.0]))
    free, closing = np.zeros(6), np.array([-0.3, -0.3])
    solved = solve_contacts(facing, free, closing, np.ones(2), np.zeros((2, 3)))
    assert solved.outcome == RELAXED
    np.testing.assert_allclose(solved.velocities, 0.0, atol=1e-10)
