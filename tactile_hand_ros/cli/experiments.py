# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand scenarios`, `show`, `sweep` and `reproduce`: what can be run, and studies of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import (
    JobsOption,
    SeedOption,
    check_writable,
    console,
    print_files,
    print_table,
    progress,
    steps,
)
from tactile_hand_ros.command_options import with_options


def scenarios() -> None:
    """List the scenarios of the package."""
    from tactile_hand_ros.config.paths import scenario_names
    from tactile_hand_ros.scenario.scenario import load_scenario

    rows = []
    for name in scenario_names():
        scenario = load_scenario(name)
        rows.append([name, f"{scenario.duration:g} s", scenario.description])
    print_table("scenarios", ("name", "duration", "description"), rows)


def show(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a YAML file.")],
) -> None:
    """Print a scenario as YAML with every value resolved."""
    from tactile_hand_ros.scenario.scenario import load_scenario, resolved

    print(resolved(load_scenario(scenario)), end="")


@dataclass(frozen=True)
class SweepOptions:
    """The options of `tactile-hand sweep`."""

    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a YAML file.")]
    over: Annotated[
        list[str],
        typer.Option(
            metavar="PATH=VALUES",
            help="What is varied: LOW..HIGH, LOW..HIGH/LEVELS, LOW..HIGH:log or A,B,C.",
        ),
    ] = field(default_factory=list)
    changes: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="What stays fixed, as duration=2."),
    ] = field(default_factory=list)
    runs: Annotated[int, typer.Option(help="Number of runs.", min=1)] = 100
    sampler: Annotated[str, typer.Option(help="grid, latin, sobol or random.")] = ""
    metric: Annotated[
        list[str],
        typer.Option(
            help="outcome, slip, error, peak_force, margin or settling_time; may be repeated. By "
            "default all."
        ),
    ] = field(default_factory=list)
    seed: SeedOption = 0
    jobs: JobsOption = -1
    cluster: Annotated[str, typer.Option(help="Dask scheduler, as tcp://127.0.0.1:8786.")] = ""
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("sweep")


@with_options
def sweep(options: SweepOptions) -> None:
    """Map how the outcome of a scenario depends on its parameters.

    Writes a table, a summary and a figure. After an interruption the same command continues.
    """
    from tactile_hand_ros.config.plain_yaml import parse_changes
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.sweep import results as tables
    from tactile_hand_ros.sweep.engine import workers
    from tactile_hand_ros.sweep.sweep import make_sweep
    from tactile_hand_ros.sweep.table import keep, read_table

    out = options.out
    study = make_sweep(
        options.scenario,
        options.over,
        parse_changes(options.changes),
        options.metric,
        sampler=options.sampler,
        runs=options.runs,
        seed=options.seed,
    )
    check_writable(out)
    with workers(options.jobs, options.cluster), progress(options.scenario) as watch:
        tally = keep(study, out, watch)
    print(tally)
    results = tables.Results(study, read_table(out))
    drawn = tables.figure(results)
    pictures = [] if drawn is None else save(drawn, out, "metrics")[:1]
    page = tables.write_summary(results, out, pictures)
    print_table("outcomes", tables.FRACTION_COLUMNS, tables.fraction_rows(results))
    print_table("metrics", tables.METRIC_COLUMNS, tables.metric_rows(results))
    if rows := tables.effect_rows(results):
        print_table("what it depends on most", tables.EFFECT_COLUMNS, rows[:10])
    print(f"{page} and runs.csv")


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures and tables.")] = Path(
        "reproduction"
    ),
    layout: Annotated[
        list[str] | None, typer.Option(help="Layout of the fingers; may be repeated.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Simulated time [s], instead of the paper's 10 s."),
    ] = None,
    jobs: JobsOption = -1,
) -> None:
    """Draw the paper's figures and judge its claims."""
    from tactile_hand_ros.reproduce import reproduce as r
    from tactile_hand_ros.reproduce.claims import EXPERIMENTS, LAYOUTS
    from tactile_hand_ros.sweep.engine import workers

    layouts = list(dict.fromkeys(layout or LAYOUTS))
    check_writable(out)
    with steps("running the paper", len(layouts) * len(EXPERIMENTS)) as advance, workers(jobs):
        results = r.reproduce(layouts, duration, advance)
    with steps("drawing", len(results)) as advance:
        files = []
        for result in results:
            files += r.draw(result, out)
            advance(result.layout)
    files += r.write(results, out)
    for result in results:
        console().print(r.claim_table(result))
    print_files(files, out)


COMMANDS = (scenarios, show, sweep, reproduce)
