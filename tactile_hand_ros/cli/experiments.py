# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand scenarios`, `show`, `hand`, `sweep`, `reproduce`: scenarios, hands and studies."""

from __future__ import annotations

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


def hand(
    name: Annotated[str, typer.Argument(help="Name of a hand, or a YAML file.")],
    layout: Annotated[str, typer.Option(help="Layout of the fingers.")] = "",
    out: Annotated[Path, typer.Option(help="Folder of the picture.")] = Path(),
) -> None:
    """Check a hand's file, print its joints and fingers, and draw it."""
    from tactile_hand_ros.hand.hand import Hand
    from tactile_hand_ros.report import hand as h

    check_writable(out)
    found = Hand.load(name, layout)
    title = (
        f"{found.joints} joints, in the order of all arrays; {found.finger_mass:.3g} kg a finger"
    )
    print_table(title, h.JOINT_COLUMNS, h.joint_rows(found))
    print_table(f"{found.fingers} fingers", h.FINGER_COLUMNS, h.finger_rows(found))
    for note in h.notes(found):
        print(note)
    print_files(h.draw(found, out, Path(name).stem), out)


def sweep(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a YAML file.")],
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=VALUES",
            help="Parameter to vary: LOW..HIGH, LOW..HIGH/LEVELS, LOW..HIGH:log or A,B,C.",
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Fixed value, such as duration=2."),
    ] = None,
    runs: Annotated[
        int, typer.Option(help="Number of runs, where a range has no levels.", min=1)
    ] = 100,
    seed: SeedOption = 0,
    jobs: JobsOption = -1,
    cluster: Annotated[
        str, typer.Option(help="Dask scheduler, such as tcp://127.0.0.1:8786.")
    ] = "",
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("sweep"),
) -> None:
    """Map how the outcome of a scenario depends on its parameters.

    Writes a table and a summary. After an interruption the same command continues.
    """
    from tactile_hand_ros.config.plain_yaml import parse_changes
    from tactile_hand_ros.sweep.engine import workers
    from tactile_hand_ros.sweep.results import Results, summary_tables, write_summary
    from tactile_hand_ros.sweep.sweep import make_sweep
    from tactile_hand_ros.sweep.table import keep, read_table

    study = make_sweep(scenario, over or [], parse_changes(changes or []), runs=runs, seed=seed)
    check_writable(out)
    with workers(jobs, cluster), progress(scenario) as watch:
        keep(study, out, watch)
    results = Results(study, read_table(out))
    page = write_summary(results, out)
    for columns, rows in summary_tables(results):
        print_table("", columns, rows)
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
    files = [file for result in results for file in r.draw(result, out)]
    files.append(r.write(results, out))
    for result in results:
        console().print(r.claim_table(result))
    print_files(files, out)


COMMANDS = (scenarios, show, hand, sweep, reproduce)
