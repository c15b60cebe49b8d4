# SPDX-License-Identifier: Apache-2.0
"""Every tick is judged once: in time, late or skipped, and those that were not have a cause."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.names import LATE_FOR
from tactile_hand_ros.nodes.plant.deadlines import Deadlines
from tactile_hand_ros.nodes.plant.headroom import Headroom, sustainable
from tactile_hand_ros.ros.realtime.causes import TickWatch


@pytest.fixture
def deadlines() -> Iterator[Deadlines]:
    """Deadlines of which nothing has been judged."""
    watch = TickWatch({}, 0.002)
    yield Deadlines(watch, awaits_others=False)
    watch.close()


def test_a_command_is_late_once_the_next_tick_is_due(deadlines: Deadlines) -> None:
    deadlines.begin()
    deadlines.answered(-1)
    deadlines.due(1, 0)
    deadlines.answered(1)
    deadlines.answered(2)  # the same tick again
    assert (deadlines.in_time, deadlines.late, deadlines.skipped) == (1, 1, 0)


def test_a_tick_without_a_command_is_late(deadlines: Deadlines) -> None:
    deadlines.begin()
    deadlines.due(3, 5_000_000)
    assert (deadlines.in_time, deadlines.late, deadlines.skipped) == (0, 1, 2)
    shown: dict[str, object] = {}
    deadlines.report(shown.__setitem__)
    assert shown.pop("late_commands") == 1
    assert sum(shown.values()) == 3  # type: ignore[arg-type]
    assert all(key.startswith(LATE_FOR) for key in shown)


def test_no_command_is_expected_while_time_stands_still(deadlines: Deadlines) -> None:
    deadlines.begin()
    deadlines.forget()
    deadlines.answered(1)
    deadlines.due(1, 0)
    assert (deadlines.in_time, deadlines.late) == (0, 0)


@given(st.lists(st.integers(1, 4) | st.integers(-5, -1) | st.just(0)))
def test_ticks_are_neither_lost_nor_counted_twice(events: list[int]) -> None:
    watch = TickWatch({}, 0.002)
    deadlines = Deadlines(watch, awaits_others=True)
    deadlines.begin()
    ticks = 1
    for event in events:
        if event > 0:
            deadlines.due(event, event * 2_000_000)
            ticks += event
        else:
            deadlines.answered(event + 2)
    deadlines.due(1, 0)
    assert deadlines.in_time + deadlines.late + deadlines.skipped == ticks
    assert sum(deadlines.causes.values()) == deadlines.late + deadlines.skipped
    watch.close()


def test_a_computer_that_keeps_up_is_not_complained_of() -> None:
    now = [0.0]
    headroom = Headroom(500.0, 0.001, lambda: now[0])
    now[0] = 2.5
    assert headroom.judge(1200, 1200, "wait") == ""


def test_the_sentence_has_what_was_measured_and_what_to_do_and_ends_with_its_reason() -> None:
    now = [0.0]
    headroom = Headroom(1000.0, 0.001, lambda: now[0])
    now[0] = 1.0
    assert headroom.judge(0, 500, "use fewer fingers") == ""  # too early to tell
    now[0] = 2.0
    text = headroom.judge(200, 800, "use fewer fingers")
    assert text == (
        "this computer is too slow for 1000 Hz: 400 ticks/s are answered, 10 % in time;"
        " use fewer fingers, or set plant.rate to 250"
    )
    now[0] = 3.0
    assert headroom.judge(1000, 1800, "use fewer fingers") == text
    now[0] = 4.0
    assert headroom.judge(2200, 2800, "use fewer fingers") == ""


def test_a_rate_too_low_for_a_hand_is_not_recommended() -> None:
    for answered, remedy in ((144, "set plant.rate to 100"), (20, "end other programs")):
        now = [0.0]
        headroom = Headroom(1000.0, 0.001, lambda now=now: now[0])  # type: ignore[misc]
        now[0] = 2.0
        assert headroom.judge(0, 2 * answered, "wait").endswith(f"in time; wait, or {remedy}")


@given(st.floats(0.1, 1e4), st.sampled_from([1e-3, 5e-4, 2e-4, 3e-3]))
def test_a_recommended_rate_is_a_whole_number_of_steps_and_below_what_was_measured(
    answered: float, step: float
) -> None:
    rate = sustainable(answered, step)
    steps = 1.0 / (rate * step)
    assert steps == pytest.approx(round(steps))
    assert rate <= max(1.0, answered)


def test_a_tenth_of_the_ticks_may_be_late_and_a_window_lasts_two_seconds() -> None:
    for in_time, is_slow in ((1800, False), (1799, True)):
        now = [5.0]
        headroom = Headroom(1000.0, 0.001, lambda now=now: now[0])  # type: ignore[misc]
        headroom.restart(100, 50)
        now[0] = 6.999
        assert headroom.judge(100, 50, "wait") == ""
        now[0] = 7.0
        assert bool(headroom.judge(100 + in_time, 2050, "wait")) == is_slow


def test_the_recommended_rate_leaves_a_reserve_and_is_whole_where_that_is_possible() -> None:
    assert sustainable(1e6, 0.001) == 1000.0  # no more than one tick a step
    assert sustainable(1000.0 / 0.7, 0.001) == pytest.approx(1000.0)
    assert sustainable(714.0, 0.001) == 250.0
    assert sustainable(715.0, 0.001) == 500.0
    assert sustainable(0.0, 0.001) == 1.0
    assert sustainable(2.0, 0.003) == pytest.approx(1.0 / (0.003 * 239))  # 1.4 Hz: 238.1 steps
    assert sustainable(1e6, 0.3) == pytest.approx(1.0 / 0.3)


def test_each_skipped_tick_has_the_cause_of_the_late_one_before_it() -> None:
    watch = TickWatch({}, 0.002)
    deadlines = Deadlines(watch, awaits_others=True)
    deadlines.begin()
    deadlines.due(4, 0)
    assert (deadlines.late, deadlines.skipped, sum(deadlines.causes.values())) == (1, 3, 4)
    assert len(deadlines.causes) == 1
    deadlines.answered(-5)
    deadlines.due(3, 0)
    assert (deadlines.in_time, deadlines.late, deadlines.skipped) == (1, 1, 5)
    deadlines.answered(0)  # just in time
    assert (deadlines.in_time, deadlines.late) == (2, 1)
    watch.close()


class Noted:
    """A watch that notes what it is asked."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, object]] = []

    def begin(self, behind: float) -> None:
        self.calls.append(("begin", behind))

    def end(self, *, in_time: bool) -> None:
        self.calls.append(("end", in_time))

    def cause(self, *, awaits_others: bool) -> str:
        self.calls.append(("cause", awaits_others))
        return "preemption"

    def cause_before(self) -> str:
        return "recorder"


@pytest.mark.parametrize("others", [False, True])
def test_the_watch_follows_each_tick_and_names_its_cause(others: bool) -> None:
    watch = Noted()
    deadlines = Deadlines(watch, awaits_others=others)  # type: ignore[arg-type]
    deadlines.begin()
    deadlines.due(3, 5_000_000)
    deadlines.answered(0)
    deadlines.answered(1)
    deadlines.due(2, 1_000_000)
    deadlines.answered(1)
    deadlines.due(1, 0)
    deadlines.answered(-1)
    assert watch.calls == [
        ("begin", 0.0),
        *(("cause", others), ("begin", 0.005), ("end", True)),
        *(("begin", 0.001), ("cause", others), ("end", False)),
        *(("begin", 0.0), ("end", True)),
    ]
    assert deadlines.causes == {"preemption": 4, "recorder": 1}
    assert (deadlines.in_time, deadlines.late, deadlines.skipped) == (2, 2, 3)


def test_one_tick_a_second_is_recommended_to_a_computer_that_answers_two() -> None:
    assert sustainable(1.5 / 0.7, 0.001) == 1.0
