# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand figures`, `report`, `compare` and `summary`: what a recorded run shows."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_hand_ros.cli.output import (
    NamespaceOption,
    check_writable,
    console,
    print_table,
)
from tactile_hand_ros.errors import TactileHandError

if TYPE_CHECKING:
    from tactile_hand_ros.run.run import Run

RunArgument = Annotated[
    Path, typer.Argument(help="Folder of a run, or a bag; runs/latest by default.")
]
LATEST = Path("runs/latest")


def figures(
    run: RunArgument = LATEST,
    out: Annotated[
        Path | None, typer.Option(help="Folder; by default figures/ in the run.")
    ] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Draw the paper's Fig. 2, 3 and 4 from a recorded run, as PNG and SVG."""
    from tactile_hand_ros.report.figures import friction_figure, motion_figure
    from tactile_hand_ros.report.style import save

    opened = _open(run, namespace)
    folder = out or opened.folder / "figures"
    check_writable(folder)
    drawn = {"fig3": motion_figure(opened.record), "fig4": friction_figure({"": opened.record})}
    if opened.scenario is not None:
        from tactile_hand_ros.report.scene import grasp_figure

        drawn["fig2"] = grasp_figure(opened.record, opened.scenario)
    for name, figure in sorted(drawn.items()):
        for file in save(figure, folder, name):
            print(file)
    if opened.scenario is None:
        text = "No scenario is known, so Fig. 2 (hand and object in space) was left out."
        print(text, file=sys.stderr)


def report(
    run: RunArgument = LATEST,
    out: Annotated[Path | None, typer.Option(help="Folder; by default that of the run.")] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Write a run as one page, report.html: 3D playback, plots, metrics, assumptions."""
    from tactile_hand_ros.report.page import write_report

    if out is not None:
        check_writable(out)
    _print_page(write_report(_open(run, namespace), out))


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two or more runs or bags.")],
    out: Annotated[Path, typer.Option(help="Folder for comparison.html.")] = Path("."),
    namespace: NamespaceOption = None,
) -> None:
    """Lay runs over each other: one page with their plots, and their metrics side by side."""
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.facts import differing, labels
    from tactile_hand_ros.report.page import COMPARISON, write_comparison

    if len(runs) < 2:
        raise TactileHandError(f"{len(runs)} run was given, expected two or more to compare.")
    check_writable(out)
    opened = [_open(run, namespace) for run in runs]
    file = write_comparison(opened, out / COMPARISON)
    names = [f"{number}: {label}" for number, label in enumerate(labels(opened), 1)]
    if settings := differing(opened):
        print_table("settings that differ", ("", *names), settings)
    rows = [["", *(each.headline for each in opened)]]
    rows += tables.side_by_side([tables.metrics_rows(each.metrics) for each in opened])
    print_table("runs", ("", *names), rows)
    _print_page(file)


def summary(
    run: RunArgument = LATEST,
    namespace: NamespaceOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what a recorded run achieved, and whether its recording is complete."""
    opened = _open(run, namespace)
    if opened.assumptions_problem:
        print(f"note: {opened.assumptions_problem}", file=sys.stderr)
    if as_json:
        results = {
            "metrics": opened.metrics.to_dict(),
            "assumptions": [line.to_dict() for line in opened.assumptions],
            "bag": opened.bag_metrics.to_dict(),
        }
        print(json.dumps(results, indent=2))
        return
    from tactile_hand_ros.report import tables

    name = opened.scenario.name if opened.scenario else "unknown scenario"
    columns = ("", "")
    rows = tables.metrics_rows(opened.metrics) + tables.recovery_rows(opened.recoveries)
    print_table(f"{name}, {opened.path}", columns, rows)
    if lines := tables.assumption_rows(opened.assumptions):
        print_table("assumptions", tables.ASSUMPTION_COLUMNS, lines)
    print_table("recording", columns, tables.bag_rows(opened.bag_metrics))


def _open(path: Path, namespace: str | None) -> Run:
    from tactile_hand_ros.run.run import Run

    opened = Run(path, namespace=namespace)
    if opened.scenario_problem:
        text = f"note: without its scenario, which does not fit: {opened.scenario_problem}"
        print(text, file=sys.stderr)
    return opened


def _print_page(file: Path) -> None:
    """Print where a page is, and its size."""
    console().print(f"{file}  {1e-6 * file.stat().st_size:.1f} MB", soft_wrap=True, markup=False)


COMMANDS = (figures, report, compare, summary)
