# SPDX-License-Identifier: Apache-2.0
"""Two senders of commands are told by their answers to the same tick."""

import numpy as np

from tactile_hand_ros.nodes.plant.senders import SenderWatch

TORQUE = np.ones(3)


class Now:
    """A clock that is set by hand."""

    time = 0.0

    def __call__(self) -> float:
        return self.time


def test_one_sender_may_repeat_its_answer():
    watch = SenderWatch()
    assert not watch.note(1, TORQUE) and not watch.note(1, TORQUE.copy())
    assert not watch.in_conflict and not watch.ended() and watch.conflicts == 0


def test_another_answer_is_a_conflict_that_ends_after_half_a_second():
    now = Now()
    watch = SenderWatch(now)
    watch.note(1, TORQUE)
    assert watch.note(1, 2.0 * TORQUE) and watch.in_conflict and watch.conflicts == 1
    now.time = 0.4
    assert watch.in_conflict and not watch.ended()
    now.time = 0.6
    assert not watch.in_conflict and watch.ended() and not watch.ended()


def test_a_reset_forgets_the_answers():
    watch = SenderWatch()
    watch.note(0, TORQUE)
    watch.reset()
    assert not watch.note(0, 2.0 * TORQUE)


def test_only_so_many_answers_are_kept():
    watch = SenderWatch()
    for stamp in range(300):
        watch.note(stamp, TORQUE)
    assert not watch.note(0, 2.0 * TORQUE)
    assert watch.note(299, 2.0 * TORQUE)


def test_the_first_of_256_answers_is_remembered_and_disagreements_count():
    watch = SenderWatch()
    for stamp in range(256):
        watch.note(stamp, TORQUE)
    assert watch.note(0, 2.0 * TORQUE) and watch.note(0, 3.0 * TORQUE)
    assert watch.conflicts == 2
    watch.note(256, TORQUE)
    assert not watch.note(0, 2.0 * TORQUE)  # now it is the newest
    assert watch.note(0, TORQUE) and watch.note(256, 2.0 * TORQUE)


def test_a_conflict_is_over_at_half_a_second_and_a_reset_ends_it():
    now = Now()
    watch = SenderWatch(now)
    for _ in range(2):
        watch.note(1, TORQUE)
        assert watch.note(1, 2.0 * TORQUE)
        now.time += 0.5
        assert not watch.in_conflict
    assert watch.note(1, 2.0 * TORQUE) and watch.in_conflict
    watch.reset()
    assert not watch.in_conflict and not watch.ended()
