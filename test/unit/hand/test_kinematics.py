# SPDX-License-Identifier: Apache-2.0
"""Solving for accelerations, with fingers that do not feel each other and with joints that do."""

import numpy as np
import pytest

from tactile_hand_ros.hand.kinematics import divide_by_inertia, mirrored


@pytest.mark.parametrize("fingers", [[9], [3, 3, 3], [3, 5, 4, 1]])
def test_it_solves_for_every_column(fingers):
    random = np.random.default_rng(0)
    m = sum(fingers)
    inertia, at = np.zeros((m, m)), 0
    for joints in fingers:
        root = random.standard_normal((joints, joints))
        inertia[at : at + joints, at : at + joints] = root @ root.T + 0.1 * np.eye(joints)
        at += joints
    right = random.standard_normal((m, m + 2))
    expected = np.linalg.solve(inertia, right)
    found = right.copy()
    divide_by_inertia(np.triu(inertia), found)  # nothing below the diagonal is looked at
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(mirrored(np.triu(inertia)), inertia)
