# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand reproduce` and `study`: many runs, ending in figures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import (
    FormatOption,
    JobsOption,
    Progress,
    check_writable,
    figure_formats,
    print_table,
)


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures and tables.")] = Path(
        "reproduction"
    ),
    layout: Annotated[
        list[str] | None, typer.Option(help="Layout of the fingers; may be repeated.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time in s instead of the paper's 10 s.")
    ] = None,
    jobs: JobsOption = -1,
    formats: FormatOption = None,
) -> None:
    """Draw the paper's figures and print its claims beside what was measured."""
    from tactile_hand_ros.report.tables import rich_table
    from tactile_hand_ros.studies.paper import tables
    from tactile_hand_ros.studies.paper.experiments import EXPERIMENTS, LAYOUTS
    from tactile_hand_ros.studies.paper.reproduce import draw, write
    from tactile_hand_ros.studies.paper.reproduce import reproduce as run

    layouts = list(dict.fromkeys(layout or LAYOUTS))
    figure_formats(formats)
    check_writable(out)
    with Progress("running the paper", len(layouts) * len(EXPERIMENTS)) as advance:
        results = run(layouts, duration, jobs, advance)
    with Progress("drawing", len(results)) as advance:
        files = []
        for result in results:
            files += draw(result, out, figure_formats(formats))
            advance(result.layout)
    files += write(results, out, figure_formats(formats)[0])
    for result in results:
        print_table(tables.claim_table(f"layout {result.layout}", result.claims))
        title = f"what the laws do, layout {result.layout}"
        print_table(rich_table(title, tables.LAW_COLUMNS, tables.law_rows(result.laws)))
    print(f"{len(files)} files in {out}: " + ", ".join(f.name for f in files))


def slip(
    out: Annotated[Path, typer.Option(help="Folder for figures, tables and data.")] = Path("study"),
    runs: Annotated[int, typer.Option(help="Number of runs with an event.", min=1)] = 1000,
    jobs: JobsOption = -1,
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    roc: Annotated[
        bool, typer.Option(help="Also replay the detector for its receiver operating curve.")
    ] = False,
    formats: FormatOption = None,
) -> None:
    """Measure how fast slip is found and stopped, and at what squeeze."""
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.studies.slip import figures as study_figures
    from tactile_hand_ros.studies.slip import roc as slip_roc
    from tactile_hand_ros.studies.slip import roc_figure
    from tactile_hand_ros.studies.slip import study as slip_study
    from tactile_hand_ros.studies.slip import tables as s

    figure_formats(formats)
    check_writable(out if out.exists() else out.absolute().parent)
    with Progress("holding", len(slip_study.tasks_of(runs, seed))) as advance:
        result = slip_study.run_study(runs, seed, jobs, advance)
    drawn = study_figures.figures(result)
    points: list[slip_roc.Point] = []
    if roc:
        with Progress("replaying", slip_roc.steps(slip_roc.SLIPS)) as advance:
            points = slip_roc.run_roc(seed=seed, jobs=jobs, progress=advance)
        drawn["study_roc"] = roc_figure.roc_figure(points)
    files = s.write(result, out)
    if points:
        files += slip_roc.write(points, out)
    for name, figure in drawn.items():
        files += save(figure, out, name, figure_formats(formats))
    print_table(tables.rich_table(f"slip, {runs} runs", s.COLUMNS, s.rows(result)))
    print_table(tables.rich_table("how often", s.SHARE_COLUMNS, s.share_rows(result)))
    if points:
        print_table(tables.rich_table("detector", slip_roc.COLUMNS, slip_roc.rows(points)))
    print(f"{len(files)} files in {out}: " + ", ".join(f.name for f in files))
