# SPDX-License-Identifier: Apache-2.0
"""The progress of a run in words: what is known, in units that fit, where a terminal draws it."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from tactile_hand_ros.orchestrator import view
from tactile_hand_ros.orchestrator.monitor import Look
from tactile_hand_ros.orchestrator.view import Bar, Lines, Rate, Silence, facts, make_view

LOOK = Look(time=1.25, position_error=0.0123, grasp_force=7.125)


def console(**options: Any) -> Console:
    return Console(file=io.StringIO(), width=120, **options)


def written(where: Console) -> str:
    assert isinstance(where.file, io.StringIO)
    return where.file.getvalue()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0, "0.000 mm"),
        (0.0099994, "9.999 mm"),
        (0.01, "10.0 mm"),
        (0.0123, "12.3 mm"),
        (math.nan, "no target"),
    ],
)
def test_an_error_below_a_centimetre_is_shown_to_the_micrometre(error: float, words: str) -> None:
    shown = facts(Look(0.0, error, 7.125), 499.6)
    assert shown == f"pose error {words}  k_f 7.12 N  500 ticks/s"


def test_a_squeeze_that_is_not_known_is_a_dash() -> None:
    assert facts(Look(0.0, 0.0, math.nan), 0.0) == "pose error 0.000 mm  k_f -  0 ticks/s"


@pytest.mark.parametrize(
    ("duration", "fault", "line"),
    [
        (5.5, "", f"t = 1.25 of 5.5 s  {facts(LOOK, 250.0)}\n"),
        (None, "[b] is stale", f"t = 1.25 s  {facts(LOOK, 250.0)}  ! [b] is stale\n"),
    ],
)
def test_a_line_is_for_logs_and_takes_no_markup(
    duration: float | None, fault: str, line: str
) -> None:
    where = console()
    with Lines(where, duration) as lines:
        lines.show(LOOK, 250.0, fault)
    assert written(where) == line


def test_a_bar_shows_the_same_and_is_gone_at_the_end() -> None:
    where = console(force_terminal=True, color_system=None)
    with Bar(where, 5.0) as bar:
        before = len(written(where))
        bar.show(LOOK, 250.0, "no contact")
        drawn = written(where)[before:]
    assert "  1.25 / 5 s" in drawn and facts(LOOK, 250.0) in drawn and "no contact" in drawn
    assert 5 < drawn.count("\u2501") <= 24  # a quarter is done: the rest is drawn dimmer
    assert written(where).endswith("\x1b[2K")
    with Bar(where, None) as bar:
        before = len(written(where))
        bar.show(LOOK, 250.0, "")
        assert "  1.25 s" in written(where)[before:]


@pytest.mark.parametrize(
    ("options", "quiet", "kind", "period"),
    [
        ({"force_terminal": True}, False, Bar, 0.1),
        ({"force_terminal": False}, False, Lines, 2.0),
        ({"force_terminal": True}, True, Silence, math.inf),
    ],
)
def test_a_terminal_gets_a_bar_and_a_pipe_lines(
    options: dict[str, Any], quiet: bool, kind: type, period: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    where = console(**options)
    made = make_view(where, 1.0, quiet=quiet)
    assert type(made) is kind and made.period == period
    monkeypatch.setenv("TERM", "dumb")
    assert type(make_view(where, 1.0, quiet=False)) is Lines
    if quiet:
        with made:
            made.show(LOOK, 1.0, "a fault")
        assert written(where) == ""


def test_the_rate_is_that_between_two_stamps_that_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(view, "time", SimpleNamespace(monotonic=lambda: now))
    rate = Rate(2_000_000)
    assert rate(2_000_000) == 0.0  # the first: since when is not known
    now += 0.5
    assert rate(2_000_000) == 0.0
    assert rate(202_000_000) == 200.0
    now += 0.25
    assert rate(202_000_000) == 200.0  # nothing new
    now += 0.25
    assert rate(302_000_000) == 100.0
    assert rate(402_000_000) == 100.0  # no time has passed


def test_no_thread_of_its_own_draws_the_bar_and_nothing_is_left_of_it() -> None:
    where = console(force_terminal=True)
    bar = Bar(where, 5.0)
    live = bar._progress.live
    assert not live.auto_refresh and live.transient


def test_a_line_is_one_line_however_long() -> None:
    where = console(force_terminal=False)
    with Lines(where, None) as lines:
        lines.show(LOOK, 250.0, "[bold]" + "x" * 400)
    assert written(where).count("\n") == 1 and "[bold]xxx" in written(where)
