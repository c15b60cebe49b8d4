# SPDX-License-Identifier: Apache-2.0
"""The progress of a run in words: what is known, in units that fit, where a terminal draws it."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from tactile_hand_ros.orchestrator import monitor as module
from tactile_hand_ros.orchestrator.monitor import Progress, Rate, View, facts

NOW = Progress(time=1.25, position_error=0.0123, grasp_force=7.125)


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
        (math.nan, "unknown"),
    ],
)
def test_an_error_below_a_centimetre_is_shown_to_the_micrometre(error: float, words: str) -> None:
    shown = facts(Progress(0.0, error, 7.125), 499.6)
    assert shown == f"pose error {words}  k_f 7.12 N  500 ticks/s"


def test_a_force_that_is_not_known_is_a_dash() -> None:
    assert facts(Progress(0.0, 0.0, math.nan), 0.0) == "pose error 0.000 mm  k_f -  0 ticks/s"


def test_an_error_is_shown_only_while_the_hand_drives() -> None:
    """After a drop the last error would stay on the screen."""
    held, driven = (facts(Progress(0.0, 0.1, 7.0, mode), 1.0) for mode in ("hold", "drive"))
    assert held == "not driving: hold  k_f 7.00 N  1 ticks/s"
    assert driven == "pose error 100.0 mm  k_f 7.00 N  1 ticks/s"


@pytest.mark.parametrize(
    ("duration", "fault", "line"),
    [
        (5.5, "", f"t = 1.25 of 5.5 s  {facts(NOW, 250.0)}\n"),
        (None, "[b] is stale", f"t = 1.25 s  {facts(NOW, 250.0)}  ! [b] is stale\n"),
        (None, "x" * 400, f"t = 1.25 s  {facts(NOW, 250.0)}  ! {'x' * 400}\n"),
    ],
)
def test_a_pipe_gets_a_line_now_and_then(duration: float | None, fault: str, line: str) -> None:
    where = console(force_terminal=False)
    view = View(where, duration, quiet=False)
    with view.shown():
        view.show(NOW, 250.0, fault)
    assert written(where) == line and view.period == 2.0


def test_a_bar_is_gone_at_the_end_and_a_fault_is_printed_in_full_above_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    where = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    view = View(where, 5.0, quiet=False)
    assert view.period == 0.1
    reason = f"[plant] {'why ' * 30}end"
    with view.shown():
        before = len(written(where))
        view.show(NOW, 250.0, reason)
        view.show(NOW, 250.0, reason)
        drawn = written(where)[before:]
    assert "  1.25 / 5 s" in drawn and facts(NOW, 250.0) in drawn
    assert drawn.count(reason) == 1  # a fault that stays is printed once
    assert written(where).endswith("\x1b[2K")


def test_quiet_means_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    where = console(force_terminal=True)
    quiet = View(where, 1.0, quiet=True)
    with quiet.shown():
        quiet.show(NOW, 250.0, "a fault")
    assert quiet.period == math.inf and written(where) == ""
    monkeypatch.setenv("TERM", "dumb")
    assert View(console(force_terminal=True), 1.0, quiet=False).period == 2.0


def test_the_rate_is_that_between_two_stamps_that_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
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
