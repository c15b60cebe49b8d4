# SPDX-License-Identifier: Apache-2.0
"""Angles that look like degrees are refused with what they would be in radians."""

import math

import pytest

from tactile_hand_ros.config.angles import FULL_TURN, HALF_TURN, check_radians


@pytest.mark.parametrize(
    ("most", "words"), [(HALF_TURN, "half a turn"), (FULL_TURN, "a full turn")]
)
def test_a_thousandth_beyond_a_turn_is_rounding_and_more_is_refused(most, words):
    assert most in (math.pi, 2.0 * math.pi)
    for sign in (1.0, -1.0):
        check_radians([0.0, sign * (most + 0.9999e-3), 1.0], most)
        with pytest.raises(ValueError, match=f"goes beyond {words}; angles are in rad"):
            check_radians([0.0, sign * (most + 1.0001e-3), 1.0], most)


def test_a_full_turn_is_the_default_and_no_angles_are_fine():
    check_radians([])
    check_radians([], 0.5)
    check_radians([6.28])
    with pytest.raises(ValueError, match=r"\[90, -180\] goes .*: \[1.571, -3.142\] if these are"):
        check_radians([90.0, -180.0])
