# SPDX-License-Identifier: Apache-2.0
"""Random contact problems of a hand and an object obey Signorini's and Coulomb's laws."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exact import contact_law_violation
from support.grasps import balance_in_frames, grasps

from tactile_hand_ros.simulation.coulomb import solve_contacts


@st.composite
def problems(draw):
    """Draw W = A M^-1 A^T of fingers with three joints and an object, with any velocities."""
    contacts = draw(grasps())
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    k = len(contacts.positions)
    to_object = balance_in_frames(contacts).T
    mass = np.concatenate([np.full(3, 10 ** random.uniform(-1, 1)), np.full(3, 0.01)])
    delassus = to_object / mass @ to_object.T
    for i in range(k):
        block = slice(3 * i, 3 * i + 3)
        jacobian = 0.3 * np.linalg.qr(random.standard_normal((3, 3)))[0]
        inertia = np.diag(random.uniform(0.01, 0.03, 3))
        delassus[block, block] += jacobian @ np.linalg.inv(inertia) @ jacobian.T
    free = random.uniform(0.01, 1.0) * random.standard_normal(3 * k)
    closing = np.where(random.random(k) < 0.5, 0.0, random.uniform(-0.2, 0.5, k))
    friction = random.choice([0.0, 0.1, 0.5, 1.0, 1.5], k)
    return delassus, free, closing, friction


@settings(max_examples=300)
@given(problems())
def test_impulses_obey_both_laws(problem):
    delassus, free, closing, friction = problem
    solved = solve_contacts(delassus, free, closing, friction, np.zeros((len(friction), 3)))
    assert contact_law_violation(delassus, free, closing, friction, solved.impulses) < 1e-8
    assert solved.residual <= 1e-10
    velocities = delassus @ solved.impulses.ravel() + free
    np.testing.assert_allclose(solved.velocities.ravel(), velocities, atol=1e-12)


@settings(max_examples=100)
@given(problems(), st.integers(0, 2**32 - 1))
def test_the_guess_does_not_matter(problem, seed):
    """With little friction the problem has one solution, wherever the search begins."""
    delassus, free, closing, _ = problem
    k = len(closing)
    friction = np.full(k, 0.2)
    guess = 0.01 * np.abs(np.random.default_rng(seed).standard_normal((k, 3)))
    first = solve_contacts(delassus, free, closing, friction, np.zeros((k, 3)))
    second = solve_contacts(delassus, free, closing, friction, guess)
    size = max(np.abs(first.impulses).max(), 1e-9)
    np.testing.assert_allclose(second.impulses, first.impulses, atol=1e-6 * size)


@settings(max_examples=100)
@given(problems())
def test_impulses_against_sliding_never_add_energy(problem):
    """P . w <= 0 for all contacts that touch: friction takes energy, contact gives none."""
    delassus, free, closing, friction = problem
    closing = np.zeros_like(closing)
    solved = solve_contacts(delassus, free, closing, friction, np.zeros((len(friction), 3)))
    power = (solved.impulses * solved.velocities).sum(axis=1)
    scale = np.abs(solved.impulses).max() * np.abs(free).max()
    assert power.max() <= 1e-9 * scale
