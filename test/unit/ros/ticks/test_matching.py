# SPDX-License-Identifier: Apache-2.0
"""Whatever order messages come in, sets are complete, in order and of one stamp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.ticks.matching import REPEAT, StampMatcher

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
        assert matcher.pending <= 5
        if result is not None and result is not REPEAT:
            assert len(set(result)) == 1


def test_the_first_key_of_an_answered_stamp_asks_for_the_answer_again():
    matcher = StampMatcher(("a", "b"))
    assert matcher.put("a", 1, "x") is None
    assert matcher.put("b", 1, "y") == ("x", "y")
    assert matcher.put("a", 1, "x") is REPEAT
    assert matcher.put("b", 1, "y") is None
    assert matcher.put("a", 0, "x") is None


def test_a_repeated_value_of_an_open_stamp_replaces_the_first():
    matcher = StampMatcher(("a", "b"))
    matcher.put("a", 1, "old")
    assert matcher.put("a", 1, "new") is None
    assert matcher.put("b", 1, "y") == ("new", "y")


def test_an_incomplete_older_stamp_is_given_up():
    matcher = StampMatcher(("a", "b"))
    matcher.put("a", 1, 0)
    matcher.put("a", 2, 0)
    assert matcher.put("b", 2, 0) == (0, 0)
    assert matcher.pending == 0
    assert matcher.put("b", 1, 0) is None
    assert matcher.pending == 0


def test_a_single_stream_matches_at_once():
    matcher = StampMatcher(("a",))
    assert matcher.put("a", 5, "x") == ("x",)
    assert matcher.put("a", 5, "x") is REPEAT


def test_a_restarted_sender_is_followed():
    matcher = StampMatcher(("a", "b"), restart_after_ns=100)
    matcher.put("a", 1000, 0)
    matcher.put("b", 1000, 0)
    assert matcher.put("a", 900, 0) is None
    assert matcher.put("b", 900, 0) is None
    assert matcher.put("a", 0, "new") is None
    assert matcher.put("b", 0, "start") == ("new", "start")


SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("stamp", "restarts"),
    [(4 * SECOND, False), (4 * SECOND - 1, True), (1, True), (0, True), (5 * SECOND - 1, False)],
)
def test_a_set_more_than_a_second_back_is_a_restart(stamp, restarts):
    matcher = StampMatcher(("a", "b"))
    for key in ("a", "b"):
        matcher.put(key, 5 * SECOND, "old")
    assert matcher.put("b", stamp, "new") is None
    assert matcher.put("a", stamp, "new") == (("new", "new") if restarts else None)
    assert matcher.last == (stamp if restarts else 5 * SECOND)


def test_a_little_way_back_only_the_first_stamp_of_all_restarts():
    for stamp, answer in ((2, None), (1, None), (0, ("new",))):
        matcher = StampMatcher(("a",))
        matcher.put("a", 3, "old")
        assert matcher.put("a", stamp, "new") == answer


def test_the_first_tick_restarts_whatever_its_distance():
    restarts = []
    matcher = StampMatcher(("a", "b"), on_restart=lambda: restarts.append(matcher.last))
    for stamp in (0, 1, 2):
        matcher.put("a", stamp, stamp)
        matcher.put("b", stamp, stamp)
    matcher.put("b", 3, "from before")
    assert matcher.put("a", 0, "new") is None and restarts == []
    assert matcher.put("b", 0, "start") == ("new", "start")
    assert restarts == [0] and matcher.pending == 0


def test_one_old_message_is_no_restart_and_does_no_harm():
    restarts = []
    matcher = StampMatcher(("a", "b"), on_restart=lambda: restarts.append(1))
    matcher.put("a", 5, 0)
    matcher.put("b", 5, 0)
    assert matcher.put("a", 0, "stray") is None
    matcher.put("a", 6, 1)
    assert matcher.put("b", 6, 2) == (1, 2) and restarts == []


def test_a_restart_is_seen_with_a_full_memory():
    matcher = StampMatcher(("a", "b"), memory=3)
    matcher.put("a", 1, 0)
    matcher.put("b", 1, 0)
    for stamp in range(2, 9):
        matcher.put("a", stamp, 0)
    matcher.put("a", 0, "new")
    assert matcher.put("b", 0, "start") == ("new", "start")


def test_what_is_missing_is_named():
    matcher = StampMatcher(KEYS)
    assert matcher.missing() == [] and matcher.missing(7) == []
    matcher.put("joints", 7, 0)
    matcher.put("joints", 8, 0)
    matcher.put("force", 8, 0)
    assert matcher.missing() == matcher.missing(7) == ["contacts", "force"]
    assert matcher.missing(8) == ["contacts"]


@pytest.mark.parametrize("ahead", [150_000_000, 900_000_000, 10**12, 2**31 * 10**9 - 1])
def test_one_stamp_far_ahead_does_not_silence_the_others(ahead):
    """A single hostile message, whatever its stamp: it is not answered, and all others are."""
    restarts = []
    matcher = StampMatcher(("a",), on_restart=lambda: restarts.append(1))
    answered = []
    for tick in range(6):
        stamp = 2_000_000 * tick
        if tick in (2, 4):
            assert matcher.put("a", stamp + ahead, "hostile") is None
        answered.append(matcher.put("a", stamp, tick))
    assert answered == [(tick,) for tick in range(6)] and not restarts and not matcher.pending


def test_ticks_that_were_lost_cost_one_tick_more():
    matcher = StampMatcher(("a",))
    matcher.put("a", 0, 0)
    assert matcher.put("a", 10**10, 1) is None
    assert matcher.put("a", 10**10 + 1, 2) == (2,)
    assert matcher.put("a", 10**10 + 2, 3) == (3,)


def test_slow_ticks_are_answered_when_they_are_sent_again():
    """A plant in lockstep repeats a tick that is not answered, and its ticks may be far apart."""
    matcher = StampMatcher(("a", "b"))
    answers = []
    for tick in range(4):
        sent = [matcher.put(key, tick * 10**10, tick) for key in "abab"]
        answers.append([answer for answer in sent if isinstance(answer, tuple)])
    assert answers == [[(tick, tick)] for tick in range(4)]


def test_values_are_never_compared():
    matcher = StampMatcher(("a", "b", "c"))
    value = np.zeros(3)
    matcher.put("a", 1, value)
    matcher.put("b", 1, value)
    assert matcher.put("c", 1, value) == (value, value, value)


def test_just_so_many_incomplete_stamps_are_kept_and_the_first_to_come_goes_first():
    for memory, options in ((3, {"memory": 3}), (100, {})):
        matcher = StampMatcher(("a", "b"), **options)
        for stamp in (1000, *range(memory - 1)):
            matcher.put("a", stamp, 0)
        assert matcher.pending == memory and matcher.missing(1000) == ["b"]
        matcher.put("a", 2000, 0)
        assert matcher.pending == memory and matcher.missing(1000) == []
        assert matcher.missing(0) == matcher.missing(2000) == ["b"]


def test_later_incomplete_stamps_stay_when_one_is_complete():
    matcher = StampMatcher(("a", "b"))
    for stamp in (1, 2, 3, 4):
        matcher.put("a", stamp, f"a{stamp}")
    assert matcher.put("b", 2, "b2") == ("a2", "b2")
    assert matcher.pending == 2
    assert [matcher.put("b", stamp, "b") for stamp in (3, 4)] == [("a3", "b"), ("a4", "b")]


def test_after_a_reset_nothing_is_old_or_far_ahead():
    matcher = StampMatcher(("a",))
    matcher.put("a", 10 * SECOND, 0)
    matcher.reset()
    assert matcher.last is None
    assert matcher.put("a", 10 * SECOND - 1, 1) == (1,)
    matcher.reset()
    assert matcher.put("a", 100 * SECOND, 2) == (2,)


def test_reset_forgets_everything():
    matcher = StampMatcher(("a", "b"))
    matcher.put("a", 7, 0)
    matcher.reset()
    assert matcher.pending == 0
    assert matcher.put("b", 7, 0) is None


def test_an_unknown_key_is_an_error():
    with pytest.raises(KeyError):
        StampMatcher(("a",)).put("b", 1, 0)
