# SPDX-License-Identifier: Apache-2.0
"""Whatever order messages come in, sets are complete, in order and of one stamp."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.ticks import StampMatcher

KEYS = ("joints", "contacts", "force")


@st.composite
def interleavings(draw):
    """Streams that are each in order but arrive mixed; some messages are lost."""
    count = draw(st.integers(1, 12))
    streams = {key: list(range(count)) for key in KEYS}
    for key in KEYS:
        lost = draw(st.sets(st.integers(0, count - 1), max_size=3))
        streams[key] = [stamp for stamp in streams[key] if stamp not in lost]
    order = draw(st.permutations([key for key in KEYS for _ in streams[key]]))
    positions = dict.fromkeys(KEYS, 0)
    arrivals = []
    for key in order:
        arrivals.append((key, streams[key][positions[key]]))
        positions[key] += 1
    return streams, arrivals


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
    assert set(stamps) <= set.intersection(*map(set, streams.values()))
    # Streams in order complete their sets in order: none that could be complete is missed.
    assert set(stamps) == set.intersection(*map(set, streams.values()))


@given(st.lists(st.tuples(st.sampled_from(KEYS), st.integers(0, 10**6)), max_size=300))
def test_memory_is_bounded_whatever_comes(arrivals):
    matcher = StampMatcher(KEYS, memory=5)
    for key, stamp in arrivals:
        result = matcher.put(key, stamp, stamp)
        assert len(matcher.pending) <= 5
        if result is not None:
            assert len(set(result)) == 1


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
    assert matcher.missing(6 * SECOND) == ([] if restarts else ["a"])


def test_a_little_way_back_only_the_first_stamp_of_all_restarts():
    for stamp, answer in ((2, None), (1, None), (0, ("new",))):
        matcher = StampMatcher(("a",))
        matcher.put("a", 3, "old")
        assert matcher.put("a", stamp, "new") == answer


def test_what_is_missing_is_named():
    matcher = StampMatcher(KEYS)
    assert matcher.missing(7) == []
    matcher.put("joints", 7, 0)
    matcher.put("joints", 8, 0)
    matcher.put("force", 8, 0)
    assert matcher.missing(7) == ["contacts", "force"]
    assert matcher.missing(8) == ["contacts"]


def test_just_so_many_incomplete_stamps_are_kept_and_the_first_to_come_goes_first():
    matcher = StampMatcher(("a", "b"), memory=3)
    for stamp in (1000, 0, 1):
        matcher.put("a", stamp, 0)
    assert list(matcher.pending) == [1000, 0, 1]
    matcher.put("a", 2000, 0)
    assert list(matcher.pending) == [0, 1, 2000]
