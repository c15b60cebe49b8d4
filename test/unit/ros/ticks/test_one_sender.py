# SPDX-License-Identifier: Apache-2.0
"""Two senders of the same ticks are told by what they send; one that repeats itself is not two."""

from tactile_hand_ros.ros.ticks.one_sender import OneSender

TICK = 2_000_000


def test_one_sender_may_repeat_its_ticks():
    made = OneSender()
    for tick in (1, 2, 2, 3, 2):
        assert not made.disagree(tick * TICK, b"%d" % tick)


def test_two_senders_disagree_until_half_a_second_after_the_last_difference():
    made = OneSender()
    assert not made.disagree(TICK, b"one")
    assert made.disagree(TICK, b"other")
    assert made.disagree(250 * TICK, b"one")
    assert not made.disagree(252 * TICK, b"one")


def test_time_that_starts_over_is_no_second_sender():
    made = OneSender()
    for tick in range(1, 4):
        made.disagree(tick * TICK, b"first")
    for tick in range(4):
        assert not made.disagree(tick * TICK, b"second")


def test_time_that_starts_over_after_a_few_ticks_is_no_second_sender():
    """Also while the first tick of the run before is still remembered."""
    made = OneSender()
    for run in (b"first", b"second", b"third"):
        for tick in range(4):
            assert not made.disagree(tick * TICK, run)


def test_a_difference_counts_for_half_a_second_and_not_longer():
    made = OneSender()
    made.disagree(7, b"one")
    assert made.disagree(7, b"other")
    assert made.disagree(7 + 500_000_000, b"next")
    assert not made.disagree(7 + 500_000_001, b"next")
    assert not made.disagree(8, b"over")


def test_two_senders_of_the_first_tick_of_all_disagree():
    made = OneSender()
    assert not made.disagree(0, b"one")
    assert made.disagree(0, b"other")


def test_time_that_starts_over_ends_a_disagreement():
    made = OneSender()
    made.disagree(1, b"one")
    assert made.disagree(1, b"other")
    assert not made.disagree(0, b"one")
    assert not made.disagree(1, b"third")


def test_the_oldest_ticks_are_forgotten_first():
    made = OneSender()
    for stamp in range(1, 257):
        made.disagree(stamp, b"one")
    assert made.disagree(1, b"other")  # 256 ticks are remembered
    made = OneSender()
    for stamp in range(1, 258):
        made.disagree(stamp, b"one")
    assert not made.disagree(1, b"other")
    assert made.disagree(257, b"other")
