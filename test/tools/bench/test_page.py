# SPDX-License-Identifier: Apache-2.0
"""The page of a bench shows misses first and peers below what they are compared with."""

from __future__ import annotations

from pathlib import Path

from bench import comparison, page
from bench.comparison import Saved
from bench.results import Goal, Result

FAST = Result.of("fast", "us", [10.0, 11.0], Goal("median", at_most=20.0))
SLOW = Result.of("slow", "us", [31.0, 32.0], Goal("p99", at_most=30.0)).against(FAST)
OTHER = Result.of("other", "ticks/s", [5.0], Goal("median", at_least=4.0))


def test_misses_come_first_with_the_value_that_was_judged() -> None:
    rows = page.goal_rows([FAST, SLOW, OTHER], Saved())
    assert [row[0] for row in rows] == ["slow", "fast", "other"]
    assert rows[0][1:4] == ["31.99 us", "99 % <= 30 us", "fail"]
    assert rows[2][1:4] == ["5 ticks/s", "median >= 4 ticks/s", "pass"]


def test_a_peer_is_below_its_rival_whatever_the_order() -> None:
    (section,) = page.sections([SLOW, OTHER, FAST]).values()
    assert [result.name for result in section] == ["other", "fast", "slow"]
    rows = page.rows(section, Saved())
    assert [row[0] for row in rows] == ["other", "fast", "  slow"]
    assert rows[2][4] == "3.00 x"
    assert rows[0][2:4] == ["", ""]  # one sample has no tail
    assert page.rows([SLOW], Saved())[0][4] == "3.00 x fast"


def test_saved_results_are_compared_with_and_anything_else_is_none(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    assert comparison.load(file) == Saved()
    comparison.save([FAST, OTHER], 1234.0, file)
    saved = comparison.load(file)
    assert (saved.calls, saved.medians) == (1234.0, {"fast": 10.5, "other": 5.0})
    faster = Result.of("fast", "us", [5.25])
    assert (saved.change(faster), saved.change(SLOW)) == ("0.50 x", "")
    assert "1300 ticks/s, 1234 when" in comparison.speed_line(1300.0, saved)
    for text in ("", "[1]", '{"results": [{}]}'):
        file.write_text(text)
        assert comparison.load(file) == Saved()
