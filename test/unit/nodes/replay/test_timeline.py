# SPDX-License-Identifier: Apache-2.0
"""Time of a bag against time on the wall."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.nodes.replay.timeline import Timeline

SECOND = 1_000_000_000


def test_paused_at_first() -> None:
    """Nothing is due until it goes on."""
    timeline = Timeline(5 * SECOND)
    assert timeline.paused and timeline.wait(5 * SECOND, 100.0) is None
    assert timeline.position(200.0) == 5 * SECOND


@given(rate=st.floats(0.01, 100.0), ahead=st.floats(0.0, 1000.0))
def test_rate_scales_the_wait(rate: float, ahead: float) -> None:
    """A time of the bag is due when the bag is there."""
    timeline = Timeline(0, rate)
    timeline.resume(10.0)
    wait = timeline.wait(round(ahead * SECOND), 10.0)
    assert wait == pytest.approx(ahead / rate, abs=1e-6)
    assert wait is not None
    assert timeline.position(10.0 + wait) == pytest.approx(ahead * SECOND, abs=1e4)


def test_pause_takes_no_time_of_the_bag() -> None:
    """What was half a second ahead still is, however long the pause; resuming twice is once."""
    timeline = Timeline(0, 2.0)
    timeline.resume(0.0)
    timeline.pause(1.0)
    timeline.resume(50.0)
    timeline.resume(50.0)
    assert timeline.position(50.0) == 2 * SECOND
    assert timeline.wait(3 * SECOND, 50.0) == pytest.approx(0.5)


def test_jump_keeps_running_or_paused() -> None:
    """A loop begins again without a hiccup."""
    timeline = Timeline(0)
    timeline.jump(3 * SECOND, 1.0)
    assert timeline.paused and timeline.position(9.0) == 3 * SECOND
    timeline.resume(10.0)
    timeline.jump(0, 12.0)
    assert timeline.position(13.0) == SECOND


def test_what_is_due_has_no_wait_and_time_goes_on_from_where_it_stood() -> None:
    timeline = Timeline(2 * SECOND, 4.0)
    timeline.resume(10.0)
    assert not timeline.paused and timeline.position(10.5) == 4 * SECOND
    assert timeline.wait(4 * SECOND, 10.5) == pytest.approx(0.0)
    assert timeline.wait(3 * SECOND, 10.5) == pytest.approx(-0.25)
    timeline.pause(11.0)
    assert timeline.paused and timeline.position(99.0) == 6 * SECOND
    timeline.resume(20.0)
    timeline.jump(0, 20.25)
    assert timeline.position(20.5) == SECOND
