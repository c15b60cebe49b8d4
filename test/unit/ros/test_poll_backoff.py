# SPDX-License-Identifier: Apache-2.0
"""What changes is looked at often, what is calm rarely."""

from tactile_hand_ros.ros.poll_backoff import PollBackoff

OFTEN, RARELY, CALM = 0.1, 1.0, 5.0


class Hands:
    """The hands of a clock that a test moves."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def attention(often=OFTEN):
    hands = Hands()
    return PollBackoff(often, RARELY, CALM, hands), hands


def test_at_first_and_after_a_change_it_looks_often():
    made, hands = attention()
    assert made.period(False) == OFTEN and not made.is_calm
    hands.now += CALM
    assert made.is_calm and made.period(False) == RARELY
    assert made.period(True) == OFTEN
    hands.now += 0.9 * CALM
    assert made.period(False) == OFTEN
    hands.now += 0.2 * CALM
    assert made.period(False) == RARELY


def test_it_never_looks_more_often_because_it_is_calm():
    made, hands = attention(often=2.0)
    hands.now += CALM
    assert made.period(False) == 2.0
