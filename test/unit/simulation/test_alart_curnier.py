# SPDX-License-Identifier: Apache-2.0
"""The contact laws as a function: its values, its slope and how Newton's method finds its root."""

import numpy as np
import pytest

from tactile_hand_ros.simulation.alart_curnier import (
    TOLERANCE,
    contact_laws,
    eliminate,
    into_cones,
    newton,
    residual,
)

MU = np.array([0.5, 1.2, 0.3])


def laws(seed=0, push=-1.0):
    """Return the laws of three uneven contacts that close."""
    random = np.random.default_rng(seed)
    rows = random.standard_normal((9, 12)) * random.uniform(0.5, 2.0, 12)
    offset = random.standard_normal(9)
    offset[1::3] = push * (1.0 + random.random(3))
    return contact_laws(rows @ rows.T, offset, MU)


def test_what_hardly_moves_counts_as_a_hundred_millionth_of_the_largest():
    diagonal = np.array([4.0, 5e-8, 4.0, 1e-9, 1e-7, 1e-9, 1.0, 1.0, 1.0])
    made = contact_laws(np.diag(diagonal), np.ones(9), MU)
    expected = [0.25, 1.0 / 5e-8, 0.25, 1.0 / 4e-8, 1e7, 1.0 / 4e-8, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(made.mobility, expected, rtol=1e-12)
    np.testing.assert_array_equal(contact_laws(np.zeros((9, 9)), np.ones(9), MU).mobility, 1.0)
    np.testing.assert_array_equal(contact_laws(np.eye(9), np.zeros(9), MU).size, 1e-300)


def test_what_sticks_is_found_by_one_system_and_what_slides_to_rounding():
    stuck = contact_laws(np.diag(np.arange(1.0, 10.0)), np.tile([0.1, -5.0, 0.2], 3), MU)
    p, left = newton(stuck, stuck.size.copy(), 1.0)
    np.testing.assert_allclose(p, -stuck.offset / np.arange(1.0, 10.0), rtol=1e-14)
    assert left < 1e-14
    for seed in range(4):
        made = laws(seed)
        p, left = newton(made, np.zeros(9), 1.0)
        assert left < 1e-13 and residual(made, p) == pytest.approx(left, abs=1e-15)
        again, _ = newton(made, p, 0.1)
        np.testing.assert_allclose(again, p, atol=1e-12 * np.abs(p).max())


def test_where_it_cannot_begin_it_ends_at_once():
    made = laws()
    start = np.full(9, np.nan)
    p, left = newton(made, start, 1.0)
    assert np.isnan(p).all() and left == np.inf > TOLERANCE


def test_impulses_are_brought_into_their_cones_and_rounding_to_zero():
    made = contact_laws(np.eye(9), np.array([0.3, -2.0, 0.4, 0.1, -1.0, 0.1, 1.0, 1.0, 1.0]), MU)
    least = 1e-9 * made.size[1]
    p = np.array([3.0, 2.0, 4.0, 0.6, 1.0, 0.8, 1.0, least, 1.0])
    left = into_cones(made, p)
    np.testing.assert_allclose(p, [0.6, 2.0, 0.8, 0.6, 1.0, 0.8, 0.0, 0.0, 0.0], rtol=1e-15)
    assert left == pytest.approx(residual(made, p), rel=1e-12)
    p[6:] = 1e-12, 1.01 * least, 0.0
    into_cones(made, p)
    assert p[7] == 1.01 * least and p[6] == 1e-12


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_a_regular_system_has_its_solution(n):
    random = np.random.default_rng(n)
    for _ in range(5):
        matrix = random.standard_normal((n, n)) * 10.0 ** random.uniform(-3.0, 3.0, n)
        right = random.standard_normal(n)
        expected = np.linalg.solve(matrix, right)
        np.testing.assert_allclose(eliminate(matrix.copy(), right.copy()), expected, rtol=1e-8)


def test_unknowns_that_are_left_free_are_zero():
    """The pivots are 4, then 3 of the last row; the second row repeats the first."""
    matrix = np.array([[4.0, 2.0, 0.0], [8.0, 4.0, 0.0], [0.0, 0.0, 3.0]])
    found = eliminate(matrix, np.array([1.0, 2.0, 6.0]))
    np.testing.assert_allclose(found, [0.25, 0.0, 2.0], atol=1e-15)
    np.testing.assert_array_equal(eliminate(np.zeros((2, 2)), np.ones(2)), [0.0, 0.0])


def test_a_pivot_of_less_than_a_ten_trillionth_of_the_largest_is_rounding():
    for pivot, last in ((1.1e-13, 1.0), (0.9e-13, 0.0)):
        matrix = np.array([[0.0, 5.0 * pivot], [5.0, 0.0]])
        found = eliminate(matrix, np.array([5.0 * pivot, 10.0]))
        np.testing.assert_allclose(found, [2.0, last], rtol=1e-12)
