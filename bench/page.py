# SPDX-License-Identifier: Apache-2.0
"""Results as a page that fits 100 columns: goals, those that were missed first, then each section.

The column ``last run`` has today's median in units of the one that was saved last.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.comparison import Saved
from bench.results import Goal, Result
from tactile_hand_ros.report import tables

WIDTH = 100

GOAL_COLUMNS = ("measurement", "measured", "goal", "verdict", "last run")
COLUMNS = ("measurement", "median", "99 %", "largest", "peer", "last run")


def goal_rows(results: Sequence[Result], saved: Saved) -> list[list[str]]:
    """Return a row for each goal, those that were missed first."""
    pairs = [(result, goal) for result in results for goal in result.goals]
    pairs.sort(key=lambda pair: pair[1].met(pair[0]))
    return [
        [
            result.name,
            tables.number(getattr(result, goal.statistic), result.unit),
            _asked(goal, result.unit),
            "pass" if goal.met(result) else "fail",
            saved.change(result),
        ]
        for result, goal in pairs
    ]


def _asked(goal: Goal, unit: str) -> str:
    sign, limit = ("<=", goal.at_most) if goal.at_most is not None else (">=", goal.at_least)
    names = {"p99": "99 %", "p999": "99.9 %"}
    return f"{names.get(goal.statistic, goal.statistic)} {sign} {limit:g} {unit}".rstrip()


def sections(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Return results by section, each one after what it was compared with."""
    found: dict[str, list[Result]] = {}
    for result in results:
        found.setdefault(result.section, []).append(result)
    return {title: _peers_together(some) for title, some in found.items()}


def _peers_together(results: Sequence[Result]) -> list[Result]:
    names = {result.name for result in results}
    ordered: list[Result] = []

    def put(result: Result) -> None:
        ordered.append(result)
        for other in results:
            if other.beside == result.name and other is not result:
                put(other)

    for result in results:
        if result.beside not in names:
            put(result)
    return ordered


def rows(results: Sequence[Result], saved: Saved) -> list[list[str]]:
    """Return the results of one section; a peer is indented and has its ratio to the row above."""
    depth: dict[str, int] = {}
    found = []
    for result in results:
        depth[result.name] = depth.get(result.beside, -1) + 1
        found.append(
            [
                "  " * depth[result.name] + result.name,
                tables.number(result.median, result.unit),
                *_tail(result),
                _peer(result, depth),
                saved.change(result),
            ]
        )
    return found


def _tail(result: Result) -> list[str]:
    """Return the rare values, where there are enough samples to speak of them."""
    if result.count == 1:
        return ["", ""]
    return [tables.number(result.p99), tables.number(result.largest)]


def _peer(result: Result, depth: dict[str, int]) -> str:
    if not result.beside:
        return ""
    above = result.beside in depth
    return f"{result.ratio:.2f} x" + ("" if above else f" {result.beside}")
