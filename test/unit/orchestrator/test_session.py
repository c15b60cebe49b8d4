# SPDX-License-Identifier: Apache-2.0
"""A run ends when it has come to a stop, but not when its user has stopped it."""

import pytest

from tactile_hand_ros.orchestrator.session import STALL, StallCheck

SHORT, LONG = 0.9 * STALL, 1.1 * STALL


@pytest.mark.parametrize(
    ("is_endless", "tick", "mode", "stalled"),
    [
        (False, -1, "", True),  # no first tick
        (True, -1, "", True),
        (False, 40, "running", True),
        (False, 40, "holding", True),
        (False, 40, "paused", False),
        (True, 40, "holding", False),  # a user has stopped a node
    ],
)
def test_a_run_without_answers_has_stalled_unless_a_user_wants_it(is_endless, tick, mode, stalled):
    check = StallCheck(is_endless=is_endless)
    assert not check.step(1000.0, tick, mode)
    assert not check.step(1000.0 + SHORT, tick, mode)
    assert check.step(1000.0 + LONG, tick, mode) == stalled


def test_each_answer_and_each_pause_start_the_wait_again():
    check = StallCheck(is_endless=False)
    steps = [(0.0, 0, ""), (SHORT, 2, ""), (2 * SHORT, 2, "paused"), (3 * SHORT, 2, "running")]
    assert not any(check.step(*each) for each in steps)
    assert check.step(2 * SHORT + LONG, 2, "running")
