# SPDX-License-Identifier: Apache-2.0
"""The share of a squeeze that the joints can bear."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.control.effort import bearable_share

TORQUES = st.lists(st.floats(-60.0, 60.0), min_size=9, max_size=9).map(np.array)


def test_the_joint_with_the_least_room_decides():
    squeeze, rest = np.array([10.0, -30.0, 0.0]), np.array([5.0, -5.0, 3.0])
    assert bearable_share(squeeze, rest, np.full(3, 20.0)) == pytest.approx(0.5)
    assert bearable_share(squeeze, 0.0 * rest, np.full(3, 40.0)) == 1.0


@given(TORQUES, TORQUES)
def test_it_is_the_largest_share_within_the_limits_where_the_rest_is(squeeze, rest):
    limits = np.full(9, 20.0)
    rest = np.clip(rest, -19.0, 19.0)
    share = bearable_share(squeeze, rest, limits)
    assert (np.abs(share * squeeze + rest) <= limits * (1.0 + 1e-12)).all()
    if share < 1.0:
        assert (np.abs((share + 1e-6) * squeeze + rest) > limits).any()
