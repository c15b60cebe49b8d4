# SPDX-License-Identifier: Apache-2.0
"""Cholesky: separate inertias of fingers, joint inertias, and singular matrices."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.hand.hand import mirrored


@pytest.mark.parametrize("fingers", [[9], [3, 3, 3], [3, 5, 4, 1]])
def test_it_solves_for_every_column(fingers):
    random = np.random.default_rng(0)
    roots = [random.standard_normal((joints, joints)) for joints in fingers]
    inertia = block_diag(*(root @ root.T + 0.1 * np.eye(len(root)) for root in roots))
    right = random.standard_normal((len(inertia), len(inertia) + 2))
    expected = np.linalg.solve(inertia, right)
    found = right.copy()
    factor, regular = factorize(np.triu(inertia))  # only the upper triangle is used
    substitute(factor, found)
    assert regular
    np.testing.assert_allclose(factor.T @ factor, inertia, atol=1e-13 * np.abs(inertia).max())
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(mirrored(np.triu(inertia)), inertia)


def test_rows_that_depend_on_each_other_are_found():
    rows = np.random.default_rng(1).standard_normal((3, 5))
    dependent = np.vstack([rows, rows[0] - 2.0 * rows[2]])
    assert factorize(rows @ rows.T)[1]
    assert not factorize(dependent @ dependent.T)[1]
    assert not factorize(np.full((2, 2), np.nan))[1]


def test_a_pivot_counts_down_to_1e_13_of_its_diagonal():
    for left, regular in ((3e-13, True), (0.5e-13, False), (0.0, False), (-1.0, False)):
        upper = np.array([[4.0, 6.0], [0.0, 9.0 * (1.0 + left)]])
        assert factorize(upper)[1] == regular
    assert not factorize(np.array([[0.0]]))[1] and factorize(np.array([[1e-300]]))[1]
