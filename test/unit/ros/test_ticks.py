# SPDX-License-Identifier: Apache-2.0
"""Ticks are complete, ordered, of one timestamp; slow nodes catch up; two senders are detected."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.ticks import SenderCheck, StampMatcher, chosen

KEYS = ("joints", "contacts", "force")
MS = 1_000_000


@st.composite
def interleavings(draw):
    """Streams that are each in order but arrive interleaved; some messages are lost."""
    count = draw(st.integers(1, 12))
    lost = st.sets(st.integers(0, count - 1), max_size=3)
    streams = {key: sorted(set(range(count)) - draw(lost)) for key in KEYS}
    order = draw(st.permutations([key for key in KEYS for _ in streams[key]]))
    rest = {key: iter(stream) for key, stream in streams.items()}
    return streams, [(key, next(rest[key])) for key in order]


@given(interleavings())
def test_sets_are_in_order_and_never_mixed(case):
    streams, arrivals = case
    matcher, sets = StampMatcher(KEYS), []
    for key, stamp in arrivals:
        result = matcher.put(key, stamp, (key, stamp))
        if result is not None:
            sets.append(result)
    stamps = [values[0][1] for values in sets]
    assert stamps == sorted(set(stamps))
    for values in sets:
        assert values == tuple((key, values[0][1]) for key in KEYS)
    # Ordered streams complete their sets in order: no set that could be complete is missed.
    assert set(stamps) == set.intersection(*map(set, streams.values()))


def test_a_repeated_value_of_an_open_stamp_replaces_the_first():
    matcher = StampMatcher(("a", "b"))
    matcher.put("a", 1, "old")
    assert matcher.put("a", 1, "new") is None
    assert matcher.put("b", 1, "y") == ("new", "y")


SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("stamp", "restarts"),
    [(4 * SECOND, False), (4 * SECOND - 1, True), (1, True), (0, True), (5 * SECOND - 1, False)],
)
def test_a_set_more_than_a_second_back_is_a_restart(stamp, restarts):
    matcher = StampMatcher(("a", "b"))
    for key in ("a", "b"):
        matcher.put(key, 5 * SECOND, "old")
    matcher.put("b", 6 * SECOND, "of before")
    assert matcher.put("b", stamp, "new") is None
    assert matcher.put("a", stamp, "new") == (("new", "new") if restarts else None)
    assert matcher.last == (stamp if restarts else 5 * SECOND)
    assert (6 * SECOND in matcher.pending) != restarts


def test_a_little_way_back_only_the_first_stamp_of_all_restarts():
    for stamp, answer in ((2, None), (1, None), (0, ("new",))):
        matcher = StampMatcher(("a",))
        matcher.put("a", 3, "old")
        assert matcher.put("a", stamp, "new") == answer


def test_just_so_many_incomplete_stamps_are_kept_and_the_first_to_come_goes_first():
    matcher = StampMatcher(("a", "b"), memory=3)
    for stamp in (1000, 0, 1):
        matcher.put("a", stamp, 0)
    assert list(matcher.pending) == [1000, 0, 1]
    matcher.put("a", 2000, 0)
    assert list(matcher.pending) == [0, 1, 2000]


def batches(ticks: list[int], sizes: list[int]) -> list[list[int]]:
    """Cut the input into the batches that a slow node finds."""
    rest, lengths, out = iter(ticks), itertools.cycle(sizes), []
    while batch := list(itertools.islice(rest, next(lengths))):
        out.append(batch)
    return out


def answered(batches: list[list[int]], previous: int | None = None) -> list[list[int]]:
    """Return the answered ticks of those that wait together [ms]."""
    out = []
    for ticks in batches:
        stamps = chosen([tick * MS for tick in ticks], None if previous is None else previous * MS)
        out.append([stamp // MS for stamp in stamps])
        previous = ticks[-1]
    return out


def test_the_tick_before_those_that_wait_counts_and_the_first_of_all_has_none():
    assert answered([[16], [17, 18], [19, 20]]) == [[16], [18], [20]]  # 17 does not start a stretch
    assert answered([[21, 22]]) == [[21, 22]]


SIZES = st.lists(st.integers(1, 12), min_size=1, max_size=8)


@given(st.integers(0, 10**5), SIZES, SIZES, st.integers(1, 10))
def test_slow_nodes_meet_however_they_lag(first, one, other, period):
    ticks = [first + period * i for i in range(500)]
    lag = period * max(*one, *other)  # of the oldest waiting tick, plus one period
    stretch = 1 << lag.bit_length()
    firsts = {min(t for t in ticks if t // stretch == s) for s in {t // stretch for t in ticks}}
    for sizes in (one, other):
        assert firsts <= {tick for batch in answered(batches(ticks, sizes)) for tick in batch}


class Topic:
    """A check of a topic, with a test clock."""

    def __init__(self) -> None:
        self.now = 3600.0
        self.check = SenderCheck(lambda: self.now)

    def bring(self, *numbers: int | None) -> list[bool]:
        """Send messages with these numbers; return after which of them the topic is contested."""
        return [self.check.note({"publication_sequence_number": number}) for number in numbers]


def test_one_sender_may_repeat_ticks_and_lose_messages():
    """For any timestamps: a driver with a slow clock may repeat one for several samples."""
    assert not any(Topic().bring(5, 6, 7, 10, 11, 40))


def test_a_successor_is_let_in_at_once_also_after_a_conflict():
    topic = Topic()
    assert not any(topic.bring(100, 101, 1, 2, 3))
    assert topic.bring(102, 4, 103, 5)[-1] and topic.check.conflicts == 2
    topic.now += 0.5
    assert not topic.check.in_conflict
    assert not any(topic.bring(1, 2, 3))  # the driver has been restarted


def test_two_senders_in_turn_are_in_conflict_until_half_a_second_is_over():
    for first, second in ((100, 1), (1, 100), (7, 7)):
        topic = Topic()
        sent = [number for n in range(4) for number in (first + n, second + n)]
        assert topic.bring(*sent)[-1] and topic.check.in_conflict
        topic.now += 0.49
        assert topic.check.in_conflict
        topic.now += 0.01
        assert not topic.check.in_conflict


def test_two_restarts_half_a_second_apart_are_no_conflict():
    topic = Topic()
    topic.bring(9, 10, 1)
    topic.now += 0.5
    assert not any(topic.bring(2, 1, 2))


def test_without_numbers_nothing_is_found():
    topic = Topic()
    assert not any(topic.bring(None, None, None)) and not topic.check.note({})
