# SPDX-License-Identifier: Apache-2.0
"""The paper's results from scratch: runs, figures and a table of claims and measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_hand_ros.report.figures import friction_figure, motion_figure
from tactile_hand_ros.report.scene import grasp_figure
from tactile_hand_ros.report.style import pretty, save
from tactile_hand_ros.report.tables import markdown, rich_table
from tactile_hand_ros.reproduce.claims import (
    EXPERIMENTS,
    FAILS,
    HOLDS,
    PARTLY,
    ExperimentRun,
    Outcomes,
    judge,
    run_experiment,
    scenario_of,
)
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.sweep.engine import in_parallel

if TYPE_CHECKING:
    from rich.table import Table

REPORT = "reproduction.md"


@dataclass(frozen=True)
class Reproduction:
    """The results for one layout: all experiments by key, and the judged claims."""

    layout: str
    outcomes: Outcomes
    claims: list[list[str]]


def reproduce(
    layouts: Sequence[str],
    duration: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Reproduction]:
    """Run all experiments on `workers`, and judge the paper's claims.

    `duration` [s] replaces the scenarios'; `progress` is called with a sentence per experiment.
    Raise ConfigurationError if a layout or duration is invalid.
    """
    for layout in layouts:  # check before any process starts
        check_scenario(scenario_of("optimal", layout, duration))
    found: dict[str, dict[str, ExperimentRun]] = {layout: {} for layout in layouts}
    tasks = [(key, layout, duration) for layout in layouts for key in EXPERIMENTS]
    for (key, layout, _), run in zip(tasks, in_parallel(_run, tasks), strict=True):
        found[layout][key] = run
        progress(pretty(f"{layout}: {key}"))
    return [Reproduction(layout, runs, judge(runs)) for layout, runs in found.items()]


def _run(task: tuple[str, str, float | None]) -> ExperimentRun:
    return run_experiment(*task)


def draw(result: Reproduction, folder: Path) -> list[Path]:
    """Draw Fig. 2, 3 and 4 of one layout into a folder; return the files."""
    runs = {key: outcome.record for key, outcome in result.outcomes.items()}
    figures = {
        "fig2": grasp_figure(runs["optimal"], result.outcomes["optimal"].scenario),
        "fig3": motion_figure(runs["optimal"]),
        "fig4": friction_figure(
            {"tangential forces penalized": runs["optimal"], "nominal, W = I": runs["nominal"]}
        ),
    }
    return [
        file
        for name, figure in figures.items()
        for file in save(figure, folder, f"{name}_{result.layout}")
    ]


def write(results: Sequence[Reproduction], folder: Path) -> Path:
    """Write the report as Markdown next to the figures; return the file."""
    report = folder / REPORT
    report.write_text("\n".join([_HEAD, *map(_section, results)]), encoding="utf-8")
    return report


_HEAD = """# The paper's results, reproduced

Object manipulation with tactile sensing for prosthetic hands (Shaw-Cortez, Oetomo, Manzie, Choong),
Table I, in-process (`tactile-hand reproduce`). The paper does not print where the fingers
stand: `three_faces` and `pinch` are two readings of it.
"""

_FIGURES = {
    "fig2": "Fig. 2: hand and object at the start and at the end",
    "fig3": "Fig. 3: joint rates, position, orientation error, normal forces",
    "fig4": "Fig. 4: the friction coefficient that each contact needs, under both weightings",
}


def _section(result: Reproduction) -> str:
    pictures = [f"![{text}]({name}_{result.layout}.png)\n" for name, text in _FIGURES.items()]
    claims = markdown(CLAIM_COLUMNS, result.claims)
    return "\n".join([f"## Layout {result.layout}\n", claims, *pictures])


CLAIM_COLUMNS = ("source", "the paper", "measured", "verdict")
_COLORS = {HOLDS: "green", PARTLY: "yellow", FAILS: "red"}


def claim_table(result: Reproduction) -> Table:
    """Return the claims of a layout as a table for the terminal."""
    from rich.text import Text

    table = rich_table(f"layout {result.layout}", CLAIM_COLUMNS)
    for *texts, verdict in result.claims:
        table.add_row(*texts, Text(verdict, _COLORS[verdict]), end_section=True)
    return table
