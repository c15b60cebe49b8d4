# SPDX-License-Identifier: Apache-2.0
"""A slow node skips ticks such that all nodes still answer common ones."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.ticks import chosen

MS = 1_000_000


def batches(stamps: list[int], sizes: list[int]) -> list[list[int]]:
    """Cut what comes into what a slow node finds each time it looks."""
    out, at = [], 0
    while at < len(stamps):
        size = sizes[len(out) % len(sizes)]
        out.append(stamps[at : at + size])
        at += size
    return out


def answered(batches: list[list[int]], previous: int | None = None) -> list[list[int]]:
    """Return which ticks are answered of those that wait together [ms]."""
    out = []
    for ticks in batches:
        stamps = chosen([tick * MS for tick in ticks], None if previous is None else previous * MS)
        out.append([stamp // MS for stamp in stamps])
        previous = ticks[-1]
    return out


def grid(tick: int, before: int) -> int:
    """Return the largest n such that a multiple of 2^n lies in (before, tick]: looks at each."""
    return max(
        n for n in range(tick.bit_length()) for t in range(before + 1, tick + 1) if t % 2**n == 0
    )


LAGS = st.lists(st.lists(st.integers(1, 9), min_size=1, max_size=12), min_size=1, max_size=8)


@given(st.integers(0, 3000), LAGS)
def test_left_out_is_just_what_a_rounder_tick_follows(first: int, lags: list[list[int]]) -> None:
    """A tick is as round as the roundest millisecond since the tick before it."""
    last = first
    for steps in lags:
        waiting = [last + sum(steps[: i + 1]) for i in range(len(steps))]
        roundness = [grid(t, b) for t, b in zip(waiting, [last, *waiting], strict=False)]
        expected = [t for i, t in enumerate(waiting) if roundness[i] >= max(roundness[i:])]
        assert answered([waiting], last) == [expected]
        last = waiting[-1]


def test_the_tick_before_those_that_wait_counts_and_the_first_of_all_has_none() -> None:
    assert answered([[16], [17, 18], [19, 20]]) == [[16], [18], [20]]  # 17 begins nothing
    assert answered([[21, 22]]) == [[21, 22]]


SIZES = st.lists(st.integers(1, 12), min_size=1, max_size=8)


@given(st.integers(0, 10**5), SIZES, SIZES, st.integers(1, 10))
def test_slow_nodes_meet_however_they_lag(
    first: int, one: list[int], other: list[int], period: int
) -> None:
    stamps = [(first + period * i) * MS for i in range(500)]
    lag = period * max(*one, *other)  # of the oldest tick that waits, and one period
    stretch = (1 << lag.bit_length()) * MS
    firsts = {min(t for t in stamps if t // stretch == s) for s in {t // stretch for t in stamps}}
    for sizes in (one, other):
        given = answered([[t // MS for t in batch] for batch in batches(stamps, sizes)])
        assert firsts <= {tick * MS for batch in given for tick in batch}
