# SPDX-License-Identifier: Apache-2.0
"""Which rate a computer sustains: a table of real-time runs, and a recommendation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.realtime.cases import PRIORITY, RealtimeRun
from tactile_hand_ros.errors import ConfigurationError

MISSED = 0.01
"""Share of missed deadlines up to which a rate counts as sustained."""

_BARE_FACTOR = 2.0
"""The same, as a multiple of what a bare loop misses on the same computer."""

_HEADROOM = 0.5
"""Share of a period that the median answer may take: computers change their speed by a factor."""

COLUMNS = (
    "Hz",
    "nodes",
    "condition",
    "age [ms]",
    "99 %",
    "missed",
    "bare loop",
    "cores",
    "sustained",
    "cause",
)


def parse_rates(text: str) -> list[float]:
    """Read rates such as ``250,500,1000``.

    Returns:
        The rates [Hz], in order.

    Raises:
        ConfigurationError: If one is not a positive number.
    """
    try:
        rates = sorted({float(word) for word in text.split(",")})
    except ValueError:
        rates = [0.0]
    if not all(1.0 <= rate <= 10_000.0 for rate in rates):
        raise ConfigurationError(
            f"--rates is '{text}', expected ticks per second from 1 to 10000, such as 250,500,1000."
        )
    return rates


def is_sustained(run: RealtimeRun) -> bool:
    """Return whether few deadlines were missed, or few more than by a bare loop."""
    bare = run.bare.missed if run.bare else 0.0
    return run.missed <= max(MISSED, _BARE_FACTOR * bare)


def has_headroom(run: RealtimeRun) -> bool:
    """Return whether the rate would be sustained on a computer that is half as fast."""
    return is_sustained(run) and float(np.median(run.run.ages)) <= _HEADROOM / run.case.rate


def rows(runs: Sequence[RealtimeRun]) -> list[list[str]]:
    """Return runs as text, columns as in `COLUMNS`."""
    return [_row(run) for run in runs]


def _row(run: RealtimeRun) -> list[str]:
    ages = 1e3 * np.percentile(run.run.ages, (50.0, 99.0))
    causes = run.deadlines.causes
    main = max(causes, key=lambda cause: causes[cause]) if causes else ""
    return [
        f"{run.case.rate:g}",
        "composed" if run.case.composed else "processes",
        run.case.condition,
        f"{ages[0]:.2f}",
        f"{ages[1]:.2f}",
        _percent(run.missed),
        _percent(run.bare.missed) if run.bare else "",
        f"{run.run.cores:.2f}",
        "yes, with headroom" if has_headroom(run) else "yes" if is_sustained(run) else "no",
        main,
    ]


CAUSE_COLUMNS = ("missed ticks", "of", "by cause")


def cause_rows(runs: Sequence[RealtimeRun]) -> list[list[str]]:
    """Return for each run with missed ticks how many there were for which cause."""
    found = []
    for run in runs:
        causes = sorted(run.deadlines.causes.items(), key=lambda item: -item[1])
        text = ", ".join(f"{cause} {count}" for cause, count in causes)
        if text:
            found.append([str(run.case), f"{run.deadlines.due:.0f}", text])
    return found


def recommendation(runs: Sequence[RealtimeRun]) -> str:
    """Return in words which rate to use, and how."""
    sustained = [run for run in runs if is_sustained(run) and not run.case.is_loaded]
    if not sustained:
        slowest = min((run.case.rate for run in runs), default=0.0)
        return (
            f"This computer does not sustain {slowest:g} Hz: end other programs, try lower --rates,"
            " or use a faster one."
        )
    safe = [run for run in sustained if has_headroom(run)]
    best = max(safe or sustained, key=_worth)
    fastest = max(sustained, key=_worth)
    text = f"Recommended: {best.case.rate:g} Hz, {_how(best)}."
    if not safe:
        text += " There is no headroom: a slower hour of this computer will miss deadlines."
    elif fastest.case.rate > best.case.rate:
        text += f" {fastest.case.rate:g} Hz work too, {_how(fastest)}, but without headroom."
    return text


def _worth(run: RealtimeRun) -> tuple[float, bool, bool]:
    """Faster is better; at the same rate ordinary scheduling, then one process."""
    return run.case.rate, not run.case.priority, run.case.composed


def _how(run: RealtimeRun) -> str:
    where = "nodes in one process (composed)" if run.case.composed else "six processes"
    return where + (f", --priority {PRIORITY}" if run.case.priority else "")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %"
