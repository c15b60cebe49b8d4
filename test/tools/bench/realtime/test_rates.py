# SPDX-License-Identifier: Apache-2.0
"""The recommendation follows from what was missed, beside a bare loop, and from the headroom."""

from __future__ import annotations

import pytest

from bench.realtime.bare_loop import BareLoop, wake_at_each_tick
from bench.realtime.cases import ALONE, FIRST, LoadCase, RealtimeRun, summed_up
from bench.realtime.rates import (
    CAUSE_COLUMNS,
    COLUMNS,
    cause_rows,
    parse_rates,
    recommendation,
    rows,
)
from bench.runs import GraphRun
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.run.recording import read_deadlines


def run(
    rate: float, late: int, age_us: float, condition: str = ALONE, bare: float = 0.0
) -> RealtimeRun:
    """Return a run of a second in which some ticks were late."""
    facts = {
        "late_commands": str(late),
        "missed_ticks": "0",
        "lost_s": "0",
        "time_s": "1",
        "late: preemption": str(late),
        "age_histogram_us": f"{age_us}:{rate:.0f}",
    }
    case = LoadCase(rate, True, condition)
    kept = read_deadlines(facts, rate, 1.0, 1.0).to_dict()
    return summed_up(case, GraphRun({"real_time": kept}, facts, []), BareLoop(1000, bare, 1e-4))


def test_the_fastest_rate_with_headroom_is_recommended() -> None:
    text = recommendation([run(250, 0, 800), run(500, 1, 900), run(1000, 5, 800)])
    assert text == (
        "Recommended: 500 Hz, nodes in one process (composed). 1000 Hz work too, nodes in one"
        " process (composed), but without headroom."
    )


def test_without_headroom_it_says_so_and_priority_is_named() -> None:
    text = recommendation([run(500, 90, 3000), run(500, 2, 1500, FIRST)])
    assert "500 Hz, nodes in one process (composed), --priority 50." in text
    assert "There is no headroom" in text


def test_a_computer_that_is_too_slow_is_told_what_to_do() -> None:
    assert "does not sustain 250 Hz" in recommendation([run(250, 20, 3000), run(500, 90, 3000)])


def test_what_a_bare_loop_misses_may_be_missed_twice() -> None:
    assert "does not sustain" in recommendation([run(500, 15, 800)])
    assert "Recommended: 500 Hz" in recommendation([run(500, 15, 800, bare=0.02)])


def test_tables_have_a_cell_for_each_column() -> None:
    runs = [run(500, 3, 800), run(1000, 0, 400)]
    first, second = rows(runs)
    assert len(first) == len(second) == len(COLUMNS)
    assert first[5:7] == ["0.60 %", "0.00 %"] and first[-1] == "preemption"
    assert second[-2:] == ["yes, with headroom", ""]
    (causes,) = cause_rows(runs)
    assert len(causes) == len(CAUSE_COLUMNS) and causes[1:] == ["500", "preemption 3"]


def test_rates_are_read_in_order() -> None:
    assert parse_rates("1000,250, 500") == [250.0, 500.0, 1000.0]
    for text in ("", "fast", "0", "-5", "nan", "20000"):
        with pytest.raises(ConfigurationError, match="--rates"):
            parse_rates(text)


def test_a_bare_loop_counts_every_tick_that_comes_due() -> None:
    ticks, missed, delays = wake_at_each_tick(1000.0, 0.05)
    assert ticks >= 50 and 0 <= missed <= ticks - delays.count
