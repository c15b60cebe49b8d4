# SPDX-License-Identifier: Apache-2.0
"""Ticks come due as time passes; each is counted once: in time, late or skipped."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.nodes.plant.real_time import _MOST_BEHIND_NS, Brake, Pace

TICK = 1_000_000


def pace():
    hands = SimpleNamespace(now=0)
    return Pace(TICK, clock=lambda: hands.now), hands


@pytest.mark.parametrize(("late", "due"), [(-0.6, 0), (-0.4, 1), (0.6, 1), (1.2, 2), (3.0, 4)])
def test_early_and_late_calls(late, due):
    made, hands = pace()
    hands.now = round((1 + late) * TICK)
    assert made.due() == due
    assert made.skipped == max(0, due - 1)


@pytest.mark.parametrize(("late", "due", "lost"), [(0, 201, 0), (1, 1, 200 * TICK + 1)])
def test_time_up_to_a_fifth_of_a_second_is_made_up_for(late, due, lost):
    made, hands = pace()
    hands.now = 201 * TICK + late
    assert made.due() == due
    assert (made.skipped, made.lost_ns) == (due - 1, lost)


@given(st.lists(st.integers(0, 20 * TICK) | st.integers(0, 900 * TICK), max_size=50))
def test_all_time_is_ticks_or_lost_and_all_ticks_are_seen_or_missed(steps):
    made, hands = pace()
    total, calls = 0, 0
    for step in steps:
        hands.now += step
        due = made.due()
        total += due
        calls += due > 0
        assert abs(hands.now - total * TICK - made.lost_ns) <= TICK
        assert made.skipped == total - calls


@given(st.lists(st.integers(1, 4) | st.integers(-5, 0)))
def test_each_tick_is_judged_once(events):
    made, hands = pace()
    made.start()
    ticks, in_time, awaits = 1, 0, True
    for event in events:
        if event > 0:
            hands.now += event * TICK
            ticks += made.due()
            awaits = True
        elif awaits:
            late = made.late
            made.answered()
            in_time += made.late == late
            awaits = False
            made.answered()  # the same tick again
    hands.now += TICK
    made.due()
    assert in_time + made.late + made.skipped == ticks


def test_a_command_is_late_once_the_next_tick_is_due():
    made, hands = pace()
    made.start()
    hands.now = TICK
    made.answered()  # just in time
    assert (made.late, made.due()) == (0, 1)
    hands.now = 2 * TICK + 1
    made.answered()
    assert made.late == 1
    made.due()
    made.start(awaits_command=False)
    hands.now += 3 * TICK
    made.answered()
    made.due()
    assert made.late == 1  # no command was expected while time stood still


def test_a_brake_permits_ticks_at_its_speed_and_makes_up_for_a_slow_one():
    hands = SimpleNamespace(now=0)
    brake = Brake(TICK, lambda: hands.now)
    assert [brake.permits() for _ in range(5)] == [True] * 5
    brake.set(0.5)
    assert brake.period == 2 * TICK

    def permitted(clock):
        hands.now += clock
        return sum(brake.permits() for _ in range(500))

    assert permitted(0) == 1
    assert [permitted(TICK) for _ in range(6)].count(1) == 3
    assert permitted(20 * TICK) in (10, 11)
    assert permitted(10**12) <= 1 + _MOST_BEHIND_NS // brake.period
