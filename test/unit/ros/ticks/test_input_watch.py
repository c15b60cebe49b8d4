# SPDX-License-Identifier: Apache-2.0
"""Inputs are missing when time has passed without them, and not when one's own machine is slow."""

from __future__ import annotations

from tactile_hand_ros.ros.ticks.input_watch import InputWatch

MS = 1_000_000
TIMEOUT = 500 * MS


class World:
    """A watch, and a wall clock that a test moves."""

    def __init__(self) -> None:
        self.now = 70_000 * MS
        self.watch = InputWatch(0.5, lambda: self.now)

    def after(self, wall: int, stamp: int) -> bool:
        """Let wall time pass [ns], then bring a trigger with a stamp [ns]."""
        self.now += wall
        return self.watch.triggered(stamp)


def test_inputs_are_missing_at_the_time_out_and_not_before() -> None:
    world = World()
    assert not world.after(0, 3000 * MS)
    assert not world.after(TIMEOUT - 1, 3000 * MS + TIMEOUT - 1)
    assert not world.watch.blind
    assert world.after(1, 3000 * MS + TIMEOUT)
    assert world.watch.blind


def test_in_lockstep_a_tick_waits_for_its_inputs_however_long_a_peer_stalls() -> None:
    """The plant sends the same tick again and again; it does not depend on how fast one is."""
    world = World()
    for _ in range(100):
        assert not world.after(100 * MS, 3000 * MS)
    assert not world.watch.complete()
    assert not world.after(100 * MS, 3002 * MS)


def test_one_stamp_that_lies_ahead_is_no_time_that_has_passed() -> None:
    world = World()
    assert not world.after(0, 3000 * MS)
    assert not world.after(2 * MS, 10**18)
    assert not world.after(TIMEOUT - 2 * MS - 1, 10**18)


def test_time_begins_anew_when_the_stamps_jump_back() -> None:
    """Also where the first stamp of all was the wrong one."""
    world = World()
    assert not world.after(0, 10**18)
    assert not world.after(TIMEOUT, 3000 * MS)
    assert not world.after(TIMEOUT - 1, 3000 * MS + TIMEOUT)
    assert world.after(1, 3000 * MS + TIMEOUT)


def test_silence_of_the_trigger_does_not_count_after_a_complete_set() -> None:
    world = World()
    assert not world.after(0, 0)
    assert not world.after(TIMEOUT - 1, TIMEOUT - 1) and not world.watch.complete()
    assert not world.after(10 * TIMEOUT, 11 * TIMEOUT)
    assert not world.after(TIMEOUT - 1, 12 * TIMEOUT - 1)
    assert world.after(1, 12 * TIMEOUT)


def test_inputs_stay_missing_until_a_set_is_complete_and_then_the_time_begins_anew() -> None:
    world = World()
    world.after(0, 0)
    assert world.after(TIMEOUT, TIMEOUT)
    assert world.after(0, 0)  # whatever the stamps do meanwhile
    assert world.watch.complete() and not world.watch.blind
    assert not world.watch.complete()
    assert not world.after(0, TIMEOUT + 1)
    assert not world.after(TIMEOUT - 1, 2 * TIMEOUT)


def test_a_time_out_of_seconds_is_one_to_the_nanosecond() -> None:
    watch = InputWatch(3.0, iter([0, 2_999_999_999, 3_000_000_000]).__next__)
    assert [watch.triggered(stamp) for stamp in (0, 10**10, 10**10)] == [False, False, True]
