# SPDX-License-Identifier: Apache-2.0
"""The fraction of a grasp force that the joint torques allow."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.control.laws import bearable_fraction

TORQUES = st.lists(st.floats(-60.0, 60.0), min_size=9, max_size=9).map(np.array)


@given(TORQUES, TORQUES)
def test_it_is_the_largest_fraction_within_the_limits_where_the_rest_is(force, rest):
    limits = np.full(9, 20.0)
    rest = np.clip(rest, -19.0, 19.0)
    share = bearable_fraction(force, rest, limits)
    assert (np.abs(share * force + rest) <= limits * (1.0 + 1e-12)).all()
    if share < 1.0:
        assert (np.abs((share + 1e-6) * force + rest) > limits).any()


@pytest.mark.parametrize(
    ("force", "rest", "share"),
    [
        (10.0, 10.0, 1.0),  # just at the limit
        (-10.0, -10.0, 1.0),
        (10.0, 15.0, 0.5),
        (-10.0, -15.0, 0.5),
        (5.0, 30.0, 0.0),  # already beyond it
        (-5.0, 30.0, 1.0),  # a grasp force that relieves the joint
        (0.0, 30.0, 1.0),
    ],
)
def test_a_joint_gives_what_its_limit_leaves(force, rest, share):
    others = np.array([1.0, force, -1.0]), np.array([0.0, rest, 0.0])
    assert bearable_fraction(*others, np.array([5.0, 20.0, 5.0])) == pytest.approx(share)
