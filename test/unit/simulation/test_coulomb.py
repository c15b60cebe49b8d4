# SPDX-License-Identifier: Apache-2.0
"""One and two contacts whose outcome is known."""

import numpy as np
import pytest

from tactile_hand_ros.simulation.alart_curnier import contact_laws
from tactile_hand_ros.simulation.coulomb import _without_gain, solve_contacts

EYE = np.eye(3)


def one(free, friction, closing=0.0, delassus=EYE):
    """Solve one contact; velocities are (x, n, z) and impulses push along +n."""
    return solve_contacts(
        delassus,
        np.array(free, dtype=float),
        np.array([closing]),
        np.array([friction]),
        np.zeros((1, 3)),
    )


@pytest.mark.parametrize(
    ("free", "friction", "closing", "impulse", "velocity"),
    [
        ([0.3, -1.0, 0.4], 0.51, 0.0, [-0.3, 1.0, -0.4], [0.0, 0.0, 0.0]),  # sticks
        ([3.0, -1.0, 4.0], 0.5, 0.0, [-0.3, 1.0, -0.4], [2.7, 0.0, 3.6]),  # slides
        ([1.0, -1.0, 0.0], 0.0, 0.0, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),  # slides without friction
        ([3.0, 0.1, 4.0], 0.5, 0.0, [0.0, 0.0, 0.0], [3.0, 0.1, 4.0]),  # separates
        ([0.0, -0.9, 0.0], 0.5, 1.0, [0.0, 0.0, 0.0], [0.0, -0.9, 0.0]),  # closes a gap in part
        ([0.0, -1.5, 0.0], 0.5, 1.0, [0.0, 0.5, 0.0], [0.0, -1.0, 0.0]),  # closes it and no more
        ([0.0, 0.0, 0.0], 0.5, -0.2, [0.0, 0.2, 0.0], [0.0, 0.2, 0.0]),  # leaves a penetration
    ],
)
def test_one_contact_has_its_known_answer(free, friction, closing, impulse, velocity):
    solved = one(free, friction, closing)
    np.testing.assert_allclose(solved.impulses, [impulse], atol=1e-10)
    np.testing.assert_allclose(solved.velocities, [velocity], atol=1e-10)


def test_the_cone_is_round():
    """The limit is the same in all directions, not that of a pyramid."""
    for bearing in np.linspace(0.0, 2.0 * np.pi, 13):
        slide = [5.0 * np.cos(bearing), -1.0, 5.0 * np.sin(bearing)]
        impulse = one(slide, friction=0.5).impulses[0]
        assert np.hypot(impulse[0], impulse[2]) == pytest.approx(0.5, abs=1e-10)


def test_sliding_direction_and_force_agree_when_axes_are_coupled():
    """With unequal masses the slide turns; friction still points exactly against it."""
    delassus = np.array([[2.0, 0.3, 0.5], [0.3, 1.0, -0.2], [0.5, -0.2, 0.7]])
    solved = one([2.0, -1.0, 1.0], friction=0.4, delassus=delassus)
    push, slide = solved.impulses[0, [0, 2]], solved.velocities[0, [0, 2]]
    assert np.linalg.norm(push) == pytest.approx(0.4 * solved.impulses[0, 1])
    np.testing.assert_allclose(
        push / np.linalg.norm(push), -slide / np.linalg.norm(slide), atol=1e-8
    )


def test_two_contacts_that_cannot_tell_their_load_apart_share_it():
    """W is singular: any split of the load is right, and one must be found."""
    delassus = np.kron(np.ones((2, 2)), EYE)
    free = np.tile([0.0, -1.0, 0.0], 2)
    solved = solve_contacts(delassus, free, np.zeros(2), np.ones(2), np.zeros((2, 3)))
    assert np.isfinite(solved.impulses).all() and (solved.impulses[:, 1] >= -1e-9).all()
    np.testing.assert_allclose(solved.velocities, 0.0, atol=1e-8)


@pytest.mark.parametrize(
    ("impulse", "share"),
    [(0.5, 1.0), (1.0, 1.0), (2.0, 0.5), (4.0, 0.25), (-1.0, 0.0), (0.0, 0.0)],
)
def test_impulses_that_would_add_energy_are_shortened_until_they_add_none(impulse, share):
    """Against a speed of 1 along n with W = 2: p works -p + p^2, nothing where p is 1."""
    laws = contact_laws(2.0 * EYE, np.array([0.0, -1.0, 0.0]), np.ones(1))
    p = np.array([0.0, impulse, 0.0])
    np.testing.assert_allclose(_without_gain(laws, p), share * p, rtol=1e-15)
