# SPDX-License-Identifier: Apache-2.0
"""A stamp far ahead of all others is doubted until a second one confirms it."""

import pytest

from tactile_hand_ros.ros.ticks.leaps import Leaps

SHORTEST = 100_000_000
"""A step ahead that is no leap [ns]."""


def after(*stamps: int) -> Leaps:
    """Return leaps that have believed all of these stamps [ns]."""
    made = Leaps()
    assert [made.doubts(stamp) for stamp in stamps] == [False] * len(stamps)
    return made


@pytest.mark.parametrize("stamp", [0, 1, 10**18])
def test_the_first_stamp_is_believed(stamp: int) -> None:
    assert not Leaps().doubts(stamp)


@pytest.mark.parametrize("step", [0, 1, SHORTEST // 2])
def test_a_leap_is_more_than_a_tenth_of_a_second(step: int) -> None:
    assert not after(7, 7 + step).doubts(7 + step + SHORTEST)
    assert after(7, 7 + step).doubts(7 + step + SHORTEST + 1)


@pytest.mark.parametrize("step", [60_000_000, SHORTEST])
def test_a_leap_is_more_than_twice_the_last_step(step: int) -> None:
    assert not after(7, 7 + step).doubts(7 + 3 * step)
    assert after(7, 7 + step).doubts(7 + 3 * step + 1)


def test_the_same_stamp_or_a_later_one_confirms_a_leap_and_sets_the_step() -> None:
    for confirming in (10**10, 10**10 + 1):
        made = after(0)
        assert made.doubts(10**10)
        assert not made.doubts(confirming)
        assert not made.doubts(3 * confirming)


def test_an_earlier_leap_confirms_nothing_and_is_the_one_to_confirm() -> None:
    made = after(0)
    assert made.doubts(10**10)
    assert made.doubts(10**10 - 1)
    assert not made.doubts(10**10 - 1)


def test_a_stamp_that_goes_on_refutes_a_leap() -> None:
    made = after(0)
    assert made.doubts(10**10)
    assert not made.doubts(2)
    assert made.doubts(10**10)


def test_stamps_that_go_back_are_believed_and_are_no_step() -> None:
    assert after(0, 90_000_000, 10).doubts(SHORTEST + 11)
    assert not after(0, 90_000_000, 10).doubts(SHORTEST + 10)
