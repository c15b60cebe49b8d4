# SPDX-License-Identifier: Apache-2.0
"""The delay of the joints' torques is found from what they report."""

import numpy as np
import pytest

from tactile_hand_ros.control.sensing import TorqueDelay

OFFSET = np.array([0.3, -0.2, 0.1])  # of the reported torques, N m


def follow(delay, true, noise=0.0, ticks=200, seed=3):
    """Send torques that change by 10 mN m a tick; the joints apply them `true` ticks late."""
    random = np.random.default_rng(seed)
    sent = np.cumsum(random.normal(0.0, 0.01, (ticks, 3)), axis=0)
    for tick in range(ticks):
        acted = sent[max(0, tick - 1 - true)] + OFFSET
        delay.step(acted + random.normal(0.0, noise, 3) if tick else None)
        delay.sent(sent[tick])
    return delay.ticks


@pytest.mark.parametrize("true", [0, 1, 2, 3])
def test_it_finds_the_delay_whatever_the_offset(true):
    delay = TorqueDelay(3, 3)
    assert follow(delay, true, noise=0.003) == delay.allowed == true


def test_a_delay_that_changes_is_found_again():
    delay = TorqueDelay(3, 3)
    assert follow(delay, 2) == 2
    delay.pause()  # another sender's torques, which are not compared
    delay.step(OFFSET)
    assert follow(delay, 0) == 0


@pytest.mark.parametrize("largest", [2, 3])
def test_where_noise_hides_it_the_largest_is_allowed_for(largest):
    delay = TorqueDelay(largest, 3)
    assert follow(delay, 1, noise=0.05) is None
    assert delay.allowed == largest


def test_torques_that_are_unknown_or_stay_show_no_delay():
    delay = TorqueDelay(3, 3)
    for _ in range(200):
        delay.step(None)
        delay.sent(OFFSET)
    for _ in range(200):
        delay.step(OFFSET)
        delay.sent(OFFSET)
    assert delay.ticks is None
