# SPDX-License-Identifier: Apache-2.0
"""Two publishers of a topic are found by the numbers of their messages; a successor is let in."""

from __future__ import annotations

from tactile_hand_ros.ros.ticks import SenderCheck


class Topic:
    """A check of a topic, and a clock that a test moves."""

    def __init__(self) -> None:
        self.now = 3600.0
        self.check = SenderCheck(lambda: self.now)

    def bring(self, *numbers: int | None) -> list[bool]:
        """Bring messages with these numbers; return after which of them the topic is contested."""
        return [self.check.note({"publication_sequence_number": number}) for number in numbers]


def test_one_sender_may_repeat_ticks_and_lose_messages() -> None:
    """Whatever its stamps: a driver may give several samples the time of a slow clock."""
    assert not any(Topic().bring(5, 6, 7, 10, 11, 40))


def test_a_successor_is_let_in_at_once_also_after_a_conflict() -> None:
    topic = Topic()
    assert not any(topic.bring(100, 101, 1, 2, 3))
    assert topic.bring(102, 4, 103, 5)[-1] and topic.check.conflicts == 2
    topic.now += 0.5
    assert not topic.check.in_conflict
    assert not any(topic.bring(1, 2, 3))  # the driver has been restarted


def test_two_senders_in_turn_are_in_conflict_until_half_a_second_is_over() -> None:
    for first, second in ((100, 1), (1, 100), (7, 7)):
        topic = Topic()
        sent = [number for n in range(4) for number in (first + n, second + n)]
        assert topic.bring(*sent)[-1] and topic.check.in_conflict
        topic.now += 0.49
        assert topic.check.in_conflict
        topic.now += 0.01
        assert not topic.check.in_conflict


def test_two_restarts_half_a_second_apart_are_no_conflict() -> None:
    topic = Topic()
    topic.bring(9, 10, 1)
    topic.now += 0.5
    assert not any(topic.bring(2, 1, 2))


def test_without_numbers_nothing_is_found() -> None:
    topic = Topic()
    assert not any(topic.bring(None, None, None)) and not topic.check.note({})
