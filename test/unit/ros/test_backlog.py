# SPDX-License-Identifier: Apache-2.0
"""A slow node skips ticks such that all nodes still answer common ones."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.ticks import Backlog

MS = 1_000_000


def batches(stamps: list[int], sizes: list[int]) -> list[list[int]]:
    """Cut what comes into what a slow node finds each time it looks."""
    out, at = [], 0
    while at < len(stamps):
        size = sizes[len(out) % len(sizes)]
        out.append(stamps[at : at + size])
        at += size
    return out


class Answers:
    """A backlog, and what it gave to be answered."""

    def __init__(self) -> None:
        self.given: list[tuple[int, str]] = []
        self.backlog: Any = Backlog()

    def to(self, *ticks: int) -> list[int]:
        """Let ticks wait together [ms]; return which of them are answered [ms]."""
        for count, tick in enumerate(ticks):
            assert len(self.backlog) == count
            self.backlog.put(tick * MS, f"values {tick}")
        taken = self.backlog.take()
        assert not self.backlog
        assert [(stamp // MS, values) for stamp, values, _ in taken] == [
            (tick, f"values {tick}") for tick in ticks
        ]
        answered = [(stamp, values) for stamp, values, is_answered in taken if is_answered]
        self.given += answered
        return [stamp // MS for stamp, _ in answered]


def grid(tick: int, before: int) -> int:
    """Return the largest n such that a multiple of 2^n lies in (before, tick]: looks at each."""
    return max(
        n for n in range(tick.bit_length()) for t in range(before + 1, tick + 1) if t % 2**n == 0
    )


LAGS = st.lists(st.lists(st.integers(1, 9), min_size=1, max_size=12), min_size=1, max_size=8)


@given(st.integers(0, 3000), LAGS)
def test_left_out_is_just_what_a_rounder_tick_follows(first: int, lags: list[list[int]]) -> None:
    """A tick is as round as the roundest millisecond since the tick before it."""
    made, last, count = Answers(), first, 1
    assert made.to(first) == [first]
    for steps in lags:
        waiting = [last + sum(steps[: i + 1]) for i in range(len(steps))]
        roundness = [grid(t, b) for t, b in zip(waiting, [last, *waiting], strict=False)]
        expected = [t for i, t in enumerate(waiting) if roundness[i] >= max(roundness[i:])]
        assert made.to(*waiting) == expected
        last, count = waiting[-1], count + len(waiting)
    assert made.backlog.skipped == count - len(made.given)


def test_the_tick_before_those_that_wait_counts_until_ticks_start_over() -> None:
    made = Answers()
    assert made.to(16) == [16]
    assert made.to(17, 18) == [18]  # 17 begins nothing
    assert made.to(19, 20) == [20]
    assert made.to() == []
    made.backlog.put(21 * MS, "of the past")
    made.backlog.clear()
    assert made.backlog.take() == []
    assert made.to(21, 22) == [21, 22]  # the first of all has no tick before it
    assert made.backlog.skipped == 2


def test_a_second_set_of_a_waiting_tick_replaces_the_first() -> None:
    made = Answers()
    made.backlog.put(5 * MS, "old")
    made.backlog.put(5 * MS, "new")
    assert made.backlog.take() == [(5 * MS, "new", True)]


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
        made = Answers()
        for batch in batches(stamps, sizes):
            made.to(*(stamp // MS for stamp in batch))
        assert firsts <= {stamp for stamp, _ in made.given}
