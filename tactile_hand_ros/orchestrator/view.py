# SPDX-License-Identifier: Apache-2.0
"""The progress of a run: a bar in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from tactile_hand_ros.orchestrator.monitor import Look

BAR_PERIOD = 0.1
"""Time between two updates of the bar [s]."""

LINE_PERIOD = 2.0
"""Time between two plain lines [s]."""


class View(Protocol):
    """Shows how far a run is."""

    period: float

    def __enter__(self) -> View:
        """Begin."""

    def __exit__(self, *_: object) -> None:
        """End."""

    def show(self, look: Look, rate: float, fault: str) -> None:
        """Show a look at the hand, the ticks per second and the first fault, empty if none."""


class Silence:
    """Shows nothing."""

    period = math.inf

    def __enter__(self) -> Silence:
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """End."""

    def show(self, look: Look, rate: float, fault: str) -> None:
        """Show nothing."""


class Lines:
    """A plain line now and then, for logs and pipes."""

    period = LINE_PERIOD

    def __init__(self, console: Console, duration: float | None) -> None:
        """Take the duration [s], None for an endless run."""
        self._console = console
        self._duration = duration

    def __enter__(self) -> Lines:
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """End."""

    def show(self, look: Look, rate: float, fault: str) -> None:
        """Print one line."""
        of = "" if self._duration is None else f" of {self._duration:g}"
        tail = f"  ! {fault}" if fault else ""
        line = f"t = {look.time:.2f}{of} s  {facts(look, rate)}{tail}"
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


class Bar:
    """A progress bar; drawn from the caller's thread, so that no other one takes its time."""

    period = BAR_PERIOD

    def __init__(self, console: Console, duration: float | None) -> None:
        """Take the duration [s], None for an endless run."""
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[facts]}"),
            TextColumn("[yellow]{task.fields[fault]}"),
            console=console,
            auto_refresh=False,
            transient=True,
        )
        self._duration = duration
        self._task: TaskID = self._progress.add_task("", total=duration, facts="", fault="")

    def __enter__(self) -> Bar:
        """Begin to draw."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Give the terminal back."""
        self._progress.stop()

    def show(self, look: Look, rate: float, fault: str) -> None:
        """Draw again."""
        of = "" if self._duration is None else f" / {self._duration:g}"
        self._progress.update(
            self._task,
            completed=look.time,
            description=f"{look.time:6.2f}{of} s",
            facts=facts(look, rate),
            fault=fault,
            refresh=True,
        )


def facts(look: Look, rate: float) -> str:
    """Return pose error, squeeze and rate in words."""
    error = "no target" if math.isnan(look.position_error) else f"{_length(look.position_error)}"
    force = "-" if math.isnan(look.grasp_force) else f"{look.grasp_force:.2f} N"
    return f"pose error {error}  k_f {force}  {rate:.0f} ticks/s"


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3f} mm" if metres < 0.01 else f"{1e3 * metres:.1f} mm"


def make_view(console: Console, duration: float | None, *, quiet: bool) -> View:
    """Return the view that suits the console."""
    if quiet:
        return Silence()
    draws = console.is_terminal and not console.is_dumb_terminal
    return Bar(console, duration) if draws else Lines(console, duration)


class Rate:
    """Ticks per second of wall-clock time between the last two stamps that differ."""

    def __init__(self, tick: int) -> None:
        """Take the length of a tick [ns]."""
        self._tick = tick
        self._stamp: int | None = None
        self._time = self._rate = 0.0

    def __call__(self, stamp: int) -> float:
        """Return the rate at a stamp [ns], 0 before the second."""
        now = time.monotonic()
        before, since = self._stamp, now - self._time
        if stamp == before:
            return self._rate
        self._stamp, self._time = stamp, now
        if before is not None and since > 0.0:
            self._rate = (stamp - before) / self._tick / since
        return self._rate
