# SPDX-License-Identifier: Apache-2.0
"""The progress of a run: a bar in a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator

import rich.progress
from rich.console import Console

from tactile_hand_ros.orchestrator.monitor import Progress

BAR_PERIOD = 0.1
"""Time between two updates of the bar [s]."""

LINE_PERIOD = 2.0
"""Time between two plain lines [s]."""


class View:
    """Shows how far a run is."""

    def __init__(self, console: Console, duration: float | None, *, quiet: bool) -> None:
        """Prepare.

        Args:
            console: Where to write.
            duration: Simulated time of the run [s], None for an endless run.
            quiet: Whether to write nothing.
        """
        self._console, self._duration = console, duration
        self._fault = ""
        self._bar: rich.progress.Progress | None = None
        self.period = math.inf if quiet else LINE_PERIOD
        if not quiet and console.is_terminal and not console.is_dumb_terminal:
            self.period = BAR_PERIOD
            self._bar = rich.progress.Progress(
                rich.progress.TextColumn("{task.description}"),
                rich.progress.BarColumn(bar_width=None),
                rich.progress.TextColumn("{task.fields[facts]}"),
                console=console,
                auto_refresh=False,  # drawn by this thread, no other one takes its time
                transient=True,
            )
            self._task = self._bar.add_task("", total=duration, facts="")

    @contextlib.contextmanager
    def shown(self) -> Iterator[None]:
        """Show the progress for the duration of the block."""
        with self._bar or contextlib.nullcontext():
            yield

    def show(self, progress: Progress, rate: float, fault: str) -> None:
        """Show progress, ticks per second and the first fault, empty if there is none."""
        if self.period == math.inf:
            return
        if self._bar is None:
            of = "" if self._duration is None else f" of {self._duration:g}"
            tail = f"  ! {fault}" if fault else ""
            self._print(f"t = {progress.time:.2f}{of} s  {facts(progress, rate)}{tail}")
            return
        of = "" if self._duration is None else f" / {self._duration:g}"
        if fault and fault != self._fault:
            self._print(f"t = {progress.time:.2f} s  ! {fault}")  # in full, above the bar
        self._fault = fault
        self._bar.update(
            self._task,
            completed=progress.time,
            description=f"{progress.time:6.2f}{of} s",
            facts=facts(progress, rate),
            refresh=True,
        )

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def facts(progress: Progress, rate: float) -> str:
    """Return pose error, grasp force and rate in words; no error where nothing is driven."""
    force = "-" if math.isnan(progress.grasp_force) else f"{progress.grasp_force:.2f} N"
    return f"{_pose(progress)}  k_f {force}  {rate:.0f} ticks/s"


def _pose(progress: Progress) -> str:
    if progress.mode not in ("", "drive"):  # dropped, say: the last error says nothing any more
        return f"not driving: {progress.mode}"
    error = progress.position_error
    if math.isnan(error):
        return "pose error unknown"
    return "pose error " + (f"{1e3 * error:.3f} mm" if error < 0.01 else f"{1e3 * error:.1f} mm")


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
        if before is not None and stamp > before and since > 0.0:  # a reset sets time back
            self._rate = (stamp - before) / self._tick / since
        return self._rate
