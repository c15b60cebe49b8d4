# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand reproduce` and `study`: many runs, ending in figures and tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import (
    FormatOption,
    JobsOption,
    Progress,
    SeedOption,
    folder_for_results,
    print_files,
    print_table,
)
from tactile_hand_ros.cli.sweep import progress


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
    from tactile_hand_ros.studies.engine.backends import Local
    from tactile_hand_ros.studies.paper import tables
    from tactile_hand_ros.studies.paper.experiments import EXPERIMENTS, LAYOUTS
    from tactile_hand_ros.studies.paper.reproduce import draw, write
    from tactile_hand_ros.studies.paper.reproduce import reproduce as run

    layouts = list(dict.fromkeys(layout or LAYOUTS))
    kinds = folder_for_results(out, formats)
    with Progress("running the paper", len(layouts) * len(EXPERIMENTS)) as advance:
        results = run(layouts, duration, Local(jobs), advance)
    with Progress("drawing", len(results)) as advance:
        files = []
        for result in results:
            files += draw(result, out, kinds)
            advance(result.layout)
    files += write(results, out, kinds[0])
    for result in results:
        print_table(tables.claim_table(f"layout {result.layout}", result.claims))
        title = f"what the laws do, layout {result.layout}"
        print_table(rich_table(title, tables.LAW_COLUMNS, tables.law_rows(result.laws)))
    print_files(files, out)


def slip(
    out: Annotated[Path, typer.Option(help="Folder for figures, tables and data.")] = Path("study"),
    runs: Annotated[int, typer.Option(help="Number of runs with an event.", min=1)] = 1000,
    jobs: JobsOption = -1,
    seed: SeedOption = 0,
    roc: Annotated[
        bool, typer.Option(help="Also replay the detector for its receiver operating curve.")
    ] = False,
    formats: FormatOption = None,
) -> None:
    """Measure how fast slip is found and stopped, and at what squeeze."""
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.studies.engine.backends import Local
    from tactile_hand_ros.studies.slip import figures as study_figures
    from tactile_hand_ros.studies.slip import roc as slip_roc
    from tactile_hand_ros.studies.slip import roc_figure
    from tactile_hand_ros.studies.slip import study as slip_study
    from tactile_hand_ros.studies.slip import tables as s

    kinds = folder_for_results(out, formats)
    with Progress("holding", len(slip_study.tasks_of(runs, seed))) as advance:
        result = slip_study.run_study(runs, seed, Local(jobs), advance)
    drawn = study_figures.figures(result)
    points: list[slip_roc.Point] = []
    if roc:
        with Progress("replaying", slip_roc.steps(slip_roc.SLIPS)) as advance:
            points = slip_roc.run_roc(seed=seed, backend=Local(jobs), progress=advance)
        drawn["study_roc"] = roc_figure.roc_figure(points)
    files = s.write(result, out)
    if points:
        files += slip_roc.write(points, out)
    for name, figure in drawn.items():
        files += save(figure, out, name, kinds)
    print_table(tables.rich_table(f"slip, {runs} runs", s.COLUMNS, s.rows(result)))
    print_table(tables.rich_table("how often", s.SHARE_COLUMNS, s.share_rows(result)))
    if points:
        print_table(tables.rich_table("detector", slip_roc.COLUMNS, slip_roc.rows(points)))
    print_files(files, out)


def loads(
    out: Annotated[Path, typer.Option(help="Folder for figure, table and data.")] = Path("study"),
    runs: Annotated[int, typer.Option(help="Number of loads for each reserve.", min=1)] = 300,
    jobs: JobsOption = -1,
    seed: Annotated[int, typer.Option(help="Seed of the loads.", min=0)] = 0,
    floor: Annotated[
        list[float] | None,
        typer.Option(help="Floor of the reserve [N]; may be repeated. A grid by default.", min=0.0),
    ] = None,
    formats: FormatOption = None,
) -> None:
    """Let random loads hit a relaxed grasp: comfort against safety over the reserve.

    What is in the folder already is kept: after an interruption the same command goes on.
    """
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.studies.engine.backends import Local
    from tactile_hand_ros.studies.slip import loads as slip_loads
    from tactile_hand_ros.studies.slip import loads_report as report

    kinds = folder_for_results(out, formats)
    reserves = slip_loads.RESERVES
    if floor:
        reserves = tuple((value, slip_loads.DEFAULT[1]) for value in floor)
    with progress("loading") as watch:
        slip_loads.run_loads(runs, seed, out, Local(jobs), reserves, watch)
    found = slip_loads.outcomes_of(out)
    files = [report.write(found, out)]
    files += save(report.loads_figure(found), out, "study_loads", kinds)
    print_table(tables.rich_table(f"{runs} loads", report.COLUMNS, report.rows(found)))
    print_files(files, out)


def faults(
    out: Annotated[Path, typer.Option(help="Folder for figure, tables and data.")] = Path("faults"),
    runs: Annotated[
        int, typer.Option(help="Number of injections; 0 only draws what is stored.", min=0)
    ] = 500,
    seed: SeedOption = 0,
    way: Annotated[
        list[str] | None,
        typer.Option(help="calls, lockstep, composed or processes; may be repeated."),
    ] = None,
    deaths: Annotated[
        bool | None,
        typer.Option(help="Only nodes that are killed or stopped, or only all other faults."),
    ] = None,
    jobs: JobsOption = -1,
    formats: FormatOption = None,
) -> None:
    """Let parts of the running hand fail, and measure drops, time to safety and forces.

    What is in the folder already is kept: an interrupted campaign goes on where it stopped.
    """
    from tactile_hand_ros.errors import ConfigurationError
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.studies.faults import campaign, space
    from tactile_hand_ros.studies.faults import tables as fault_tables
    from tactile_hand_ros.studies.faults.figure import faults_figure

    ways = tuple(dict.fromkeys(way or space.WAYS))
    if unknown := [name for name in ways if name not in space.WAYS]:
        raise ConfigurationError(
            f"there is no way '{unknown[0]}' to run; choose from {', '.join(space.WAYS)}"
        )
    kinds = folder_for_results(out, formats)
    among = [cell for cell in space.cells() if deaths in (None, cell.is_death)]
    chosen = space.sample(runs, seed, ways=ways, among=among)
    done = campaign.load(out)
    outcomes = list(done)
    try:
        with Progress("injecting", len(chosen)) as advance:
            for outcome in campaign.keep(out, campaign.run_campaign(chosen, done, jobs, advance)):
                outcomes.append(outcome)
    except KeyboardInterrupt:
        print(f"interrupted after {len(outcomes)} runs; the same command goes on")
    files = [out / campaign.RESULTS, *fault_tables.write(outcomes, out)]
    files += save(faults_figure(outcomes), out, "faults", kinds)
    title = f"faults, {len(fault_tables.judged(outcomes))} of {len(outcomes)} runs judged"
    print_table(tables.rich_table(title, fault_tables.COLUMNS, fault_tables.rows(outcomes)))
    print_files(files, out)


def fuzz(
    seconds: Annotated[float, typer.Option(help="How long [s].", min=1.0)] = 60.0,
    seed: Annotated[int, typer.Option(help="Seed of all inputs.", min=0)] = 0,
    out: Annotated[Path, typer.Option(help="Folder for inputs that were not survived.")] = Path(
        "fuzz"
    ),
    live: Annotated[bool, typer.Option(help="Also attack running nodes, half of the time.")] = True,
    again: Annotated[
        Path | None, typer.Option("--replay", help="Read a kept input again instead.")
    ] = None,
) -> None:
    """Feed hostile bytes, requests and files to readers and nodes; count deaths, hangs, growth."""
    from tactile_hand_ros.bench.fuzz.fuzz import fuzz as run_fuzz
    from tactile_hand_ros.bench.fuzz.fuzz import replay
    from tactile_hand_ros.bench.fuzz.live import fuzz_nodes
    from tactile_hand_ros.bench.fuzz.targets import reading_targets

    with reading_targets() as targets:
        if again is not None:
            print(replay(targets, again) or "survived")
            return
        share = 0.5 if live else 1.0
        report = run_fuzz(targets, share * seconds, seed, out)
    if live:
        fuzz_nodes(report, (1.0 - share) * seconds, out)
    print(json.dumps(report.data(), indent=2))
    if report.findings or report.grew:
        raise typer.Exit(1)
