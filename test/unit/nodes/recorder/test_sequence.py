# SPDX-License-Identifier: Apache-2.0
"""Lost messages are counted from sequence numbers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.nodes.recorder.sequence import SequenceTracker


def lost(numbers: list[int], publishers: int = 1) -> int:
    """Return the losses that the tracker finds in a stream of numbers."""
    tracker = SequenceTracker(publishers)
    for number in numbers:
        tracker.see(number)
    return tracker.lost


@given(st.integers(1, 1000), st.sets(st.integers(1, 98), max_size=50))
def test_one_publisher_is_counted_exactly(first: int, gaps: set[int]) -> None:
    """Whatever is missing between the first and the last message counts, nothing else."""
    numbers = [first + i for i in range(100) if i not in gaps]
    assert lost(numbers) == len(gaps)


@given(st.lists(st.sampled_from("abc"), max_size=60))
def test_interleaved_publishers_without_loss_count_zero(order: list[str]) -> None:
    """Several publishers on one topic, each from its first message, in any order."""
    counts = dict.fromkeys("abc", 0)
    numbers = []
    for publisher in order:
        counts[publisher] += 1
        numbers.append(counts[publisher])
    assert lost(numbers) == 0


def test_a_gap_replaces_what_was_expected() -> None:
    """The number that never came is not waited for: a 5 after it begins a new publisher."""
    assert lost([1, 2, 5, 10, 5]) == 2 + 4


def test_restarted_publisher_is_no_loss() -> None:
    """A new process numbers its messages from one again."""
    assert lost([1, 2, 3, 1, 2]) == 0


def test_loss_beside_a_second_publisher_is_found() -> None:
    """The gap belongs to the publisher just below it."""
    assert lost([1, 2, 1, 5, 2, 6]) == 2


def test_publisher_that_spoke_before_the_recorder_came_is_no_loss() -> None:
    """Its numbering starts anywhere, also above that of a publisher heard before."""
    assert lost([1, 2, 7, 3, 8, 9, 4], publishers=2) == 0
    assert lost([1, 2, 7, 3, 8, 10, 4], publishers=2) == 1
    assert lost([1, 2, 7, 8]) == 4


def test_all_of_a_publisher_that_appears_later_count() -> None:
    """A restarted publisher sends at once, but takes time to find the subscription."""
    appeared: list[int] = []
    tracker = SequenceTracker(1, lambda: tracker.change(1, younger=len(appeared)))
    for number in (50, 51, 52):
        tracker.see(number)
    appeared.append(1)
    tracker.see(187)
    appeared.clear()
    for number in (188, 190):
        tracker.see(number)
    assert tracker.lost == 187


def test_a_publisher_that_may_be_older_starts_anywhere() -> None:
    """Discovery takes time, also of publishers that were there first."""
    tracker = SequenceTracker(0)
    tracker.change(2, older=2)
    for number in (70, 30, 71, 31):
        tracker.see(number)
    assert tracker.lost == 0
    tracker.see(33)
    assert tracker.lost == 1


def test_a_publisher_that_left_unheard_is_not_waited_for() -> None:
    """The number out of order is a gap of the one that stayed."""
    tracker = SequenceTracker(publishers=2)
    tracker.see(1)
    tracker.change(0)
    tracker.see(4)
    assert tracker.lost == 2


def test_each_discovered_publisher_accounts_for_one_first_number() -> None:
    """Of two older ones the first numbers are free, of a third one they are a gap."""
    tracker = SequenceTracker(0)
    tracker.change(3, older=2)
    for number in (70, 30):
        tracker.see(number)
    assert tracker.lost == 0
    tracker.see(34)
    assert tracker.lost == 3
    tracker.see(71)
    assert tracker.lost == 3


def test_older_ones_are_expected_before_younger_ones() -> None:
    tracker = SequenceTracker(0)
    tracker.change(1, older=1)
    tracker.change(2, younger=1)
    tracker.see(50)
    assert tracker.lost == 0
    tracker.see(3)
    assert tracker.lost == 2
    tracker.see(100)  # no other one is expected: a gap of the nearest below
    assert tracker.lost == 2 + 49


def test_a_first_number_below_all_others_and_a_new_first_message_are_no_loss() -> None:
    assert lost([50, 20, 51, 21]) == 0
    assert lost([50, 1, 51, 2]) == 0
    assert lost([5, 6, 8, 5]) == 1


def test_two_publishers_that_expect_the_same_number_are_two() -> None:
    assert lost([1, 1, 2, 2, 3, 3]) == 0
    assert lost([1, 1, 2, 2, 4, 4]) == 2
