# SPDX-License-Identifier: Apache-2.0
"""Who has fallen behind leaves out ticks such that everybody still meets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.backlog import chosen, rank

MS = 1_000_000


@pytest.mark.parametrize(
    ("before", "tick", "expected"),
    [(2, 3, 0), (1, 2, 1), (6, 8, 3), (7, 9, 3), (9, 11, 1), (1023, 1025, 10), (3, 13, 3)],
)
def test_rank_is_the_stretch_that_a_tick_begins(before: int, tick: int, expected: int) -> None:
    assert rank(tick * MS, before * MS) == expected
    assert rank(tick * MS + MS // 2, before * MS + MS // 3) == expected
    assert rank(tick * MS, None) > expected


def test_one_tick_is_always_answered() -> None:
    assert chosen([], None) == []
    assert chosen([7 * MS], 5 * MS) == chosen([7 * MS], None) == [7 * MS]


@pytest.mark.parametrize("offset", [0, 1])
def test_what_is_followed_by_a_higher_rank_is_left_out(offset: int) -> None:
    ticks = [(t + offset) * MS for t in (0, 2, 4, 6, 8, 10, 12)]
    assert chosen(ticks[1:6], ticks[0]) == ticks[4:6]
    assert chosen(ticks[4:7], ticks[3]) == [ticks[4], ticks[6]]


@given(st.integers(1, 10**6), st.integers(1, 200), st.integers(1, 20))
def test_the_newest_is_answered_and_few_others(first: int, count: int, period: int) -> None:
    stamps = [(first + period * i) * MS for i in range(count)]
    kept = chosen(stamps, stamps[0] - period * MS)
    assert kept[-1] == stamps[-1]
    assert kept == sorted(set(kept) & set(stamps))
    assert len(kept) <= (period * count).bit_length() + 1


def batches(stamps: list[int], sizes: list[int]) -> list[list[int]]:
    """Cut what comes into what a slow node finds each time it looks."""
    out, at = [], 0
    while at < len(stamps):
        size = sizes[len(out) % len(sizes)]
        out.append(stamps[at : at + size])
        at += size
    return out


def answers(stamps: list[int], sizes: list[int]) -> set[int]:
    """Return what a node answers that finds so many ticks each time."""
    answered: list[int] = []
    for batch in batches(stamps, sizes):
        answered += chosen(batch, answered[-1] if answered else None)
    return set(answered)


SIZES = st.lists(st.integers(1, 12), min_size=1, max_size=8)


@given(st.integers(0, 10**5), SIZES, SIZES, st.integers(1, 10))
def test_slow_nodes_meet_however_they_lag(
    first: int, one: list[int], other: list[int], period: int
) -> None:
    stamps = [(first + period * i) * MS for i in range(500)]
    lag = period * max(*one, *other)  # of the oldest tick that waits, and one period
    stretch = (1 << lag.bit_length()) * MS
    firsts = {min(t for t in stamps if t // stretch == s) for s in {t // stretch for t in stamps}}
    assert firsts <= answers(stamps, one) & answers(stamps, other)


@given(st.lists(st.integers(0, 10**10), unique=True, min_size=1, max_size=50).map(sorted))
def test_stamps_of_any_clock_will_do(stamps: list[int]) -> None:
    kept = chosen(stamps, None)
    assert kept[0] == stamps[0]  # the first of all has the highest rank
    assert kept[-1] == stamps[-1]
