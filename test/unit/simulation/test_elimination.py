# SPDX-License-Identifier: Apache-2.0
"""Gaussian elimination of regular and singular systems."""

import numpy as np
import pytest

from tactile_hand_ros.simulation.elimination import eliminate


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
