# SPDX-License-Identifier: Apache-2.0
"""`make study NAME=... ARGS=...`: many runs on all cores, ending in tables."""

from __future__ import annotations

import functools
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

# Append, so that the installed package runs, in child processes too.
if __name__ == "__main__":
    sys.path[0:1] = []
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

import typer

from tactile_hand_ros.cli.output import (
    JobsOption,
    SeedOption,
    check_writable,
    print_files,
    print_table,
    progress,
)
from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.report.tables import markdown
from tactile_hand_ros.sweep.engine import Study, in_parallel, workers
from tactile_hand_ros.sweep.table import Table as RunTable
from tactile_hand_ros.sweep.table import keep, read_table

OutOption = Annotated[Path, typer.Option(help="Folder of the results.")]
HandOption = Annotated[Literal["paper", "human"], typer.Option(help="The hand.")]
Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""Title, columns and rows."""


def _kept(study: Study, out: Path, jobs: int) -> RunTable:
    """Make the missing runs of a study, and return the table of all runs."""
    check_writable(out)
    with progress("running") as watch, workers(jobs):
        keep(study, out, watch)
    return read_table(out)


def _computed(function: Callable[[Any], Any], items: Iterable[Any], out: Path, jobs: int) -> Any:
    """Return what a function returns for each item."""
    check_writable(out)
    with workers(jobs):
        return list(in_parallel(function, items))


def _finish(out: Path, *tables: Table) -> None:
    """Print tables, and write them as Markdown."""
    text = "\n".join(markdown(columns, rows) for _, columns, rows in tables)
    out.joinpath("summary.md").write_text(text, encoding="utf-8")
    for table in tables:
        print_table(*table)
    print_files([out / "summary.md"], out)


def slip(
    out: OutOption = Path("study"),
    runs: Annotated[int, typer.Option(help="Number of runs with an event.", min=1)] = 1000,
    jobs: JobsOption = -1,
    seed: SeedOption = 0,
    hand: HandOption = "paper",
) -> None:
    """Measure how fast slip is detected and stopped, and at what grasp force."""
    from studies.slip import study as s

    table = _kept(s.study_of(runs, seed, hand), out, jobs)
    delays = (f"slip, {runs} runs", s.COLUMNS, s.rows(table))
    _finish(out, delays, ("how often", s.FRACTION_COLUMNS, s.fraction_rows(table)))


def invariance(
    out: OutOption = Path("invariance"),
    runs: Annotated[int, typer.Option(help="Number of random orientations.", min=0)] = 3,
    jobs: JobsOption = -1,
    seed: SeedOption = 0,
) -> None:
    """Rotate and shrink the hand, reorder its fingers, change rates and encoders."""
    from studies import invariance as i

    compare = functools.partial(i.compare, count=runs, seed=seed)
    found = itertools.chain.from_iterable(_computed(compare, i.SCENARIOS, out, jobs))
    _finish(out, ("invariance", i.COLUMNS, list(found)))


def loads(
    out: OutOption = Path("loads"),
    runs: Annotated[int, typer.Option(help="Number of loads for each reserve.", min=1)] = 300,
    jobs: JobsOption = -1,
    seed: SeedOption = 0,
    floor: Annotated[
        list[float] | None,
        typer.Option(help="Floor of the reserve; may be repeated. A grid by default.", min=0.0),
    ] = None,
    hand: HandOption = "paper",
) -> None:
    """Apply random loads to a relaxed grasp: comfort against safety over the reserve.

    After an interruption, the same command continues with the results in the folder.
    """
    from studies.slip import loads as load_study

    reserves = load_study.RESERVES
    if floor:
        reserves = {"floor": tuple(floor), "fraction": load_study.DEFAULT[1:]}
    table = _kept(load_study.study_of(runs, seed, reserves, hand), out, jobs)
    _finish(out, (f"{runs} loads", load_study.HEADS, load_study.rows(table)))


def faults(
    out: OutOption = Path("faults"),
    runs: Annotated[
        int, typer.Option(help="Number of injections; 0 only shows stored results.", min=0)
    ] = 500,
    seed: SeedOption = 0,
    way: Annotated[
        list[str] | None,
        typer.Option(help="in-process, lockstep, composed or processes; may be repeated."),
    ] = None,
    hand: Annotated[
        list[str] | None, typer.Option(help="paper or human; may be repeated. By default both.")
    ] = None,
    jobs: JobsOption = -1,
) -> None:
    """Inject faults into the running hand, and measure drops, time to safety and forces.

    Each way to run has a folder. An interrupted campaign continues where it stopped.
    """
    from studies.faults import campaign, space
    from tactile_hand_ros.errors import ConfigurationError

    ways, hands = tuple(dict.fromkeys(way or space.WAYS)), tuple(hand or space.SITUATIONS)
    for option, given, known in (("way", ways, space.WAYS), ("hand", hands, space.SITUATIONS)):
        if unknown := set(given).difference(known):
            raise ConfigurationError(
                f"--{option} {', '.join(unknown)} is unknown; choose from {', '.join(known)}"
            )
    check_writable(out)
    cells = space.cells(hands)
    among = [c for c in cells if c.way in ways]
    with progress("injecting") as watch:
        chosen = space.sample(runs, seed, among)
        for name, group in itertools.groupby(chosen, lambda run: run.way):
            campaign.run_campaign(list(group), out / name, jobs, watch)
    tables = [read_table(out / name) for name in ways if (out / name).is_dir()]
    _finish(out, ("faults", campaign.COLUMNS, campaign.rows(tables)))


def fuzz(
    seconds: Annotated[float, typer.Option(help="Duration [s].", min=1.0)] = 60.0,
    seed: SeedOption = 0,
) -> None:
    """Send hostile bytes to running nodes until one crashes, hangs, grows or moves the object."""
    from studies.fuzz import GROWTH, fuzz_nodes

    report = fuzz_nodes(seconds, seed)
    print(json.dumps(asdict(report), indent=2))
    if report.finding or report.growth > GROWTH:
        raise typer.Exit(1)


def stalls(
    out: OutOption = Path("stalls"),
    jobs: JobsOption = -1,
) -> None:
    """Stop and delay commands, with and without the guard."""
    from studies import stalls as s

    table = _kept(s.study_of(), out, jobs)
    title = "moved [mm] / slid [mm] / peak of the grasp force [N]"
    _finish(out, (title, s.COLUMNS, s.rows(table)))


def hands(
    out: OutOption = Path("hands"),
    jobs: JobsOption = -1,
) -> None:
    """Search for grasps with five hands that exist, and hold, move, turn and pull objects."""
    from studies import hands as h

    _finish(out, ("hands", h.COLUMNS, _computed(h.tried, h.PAIRS, out, jobs)))


def random_hands(
    out: OutOption = Path("random-hands"),
    runs: Annotated[int, typer.Option(help="Number of random hands.", min=1)] = 60,
    jobs: JobsOption = -1,
    seed: SeedOption = 0,
) -> None:
    """Grasp with random hands, stop the commands for a second, and pull the object."""
    from studies import random_hands as r

    _finish(out, ("hands", r.COLUMNS, _computed(r.tried, range(seed, seed + runs), out, jobs)))


def engines(
    out: OutOption = Path("engines"),
    jobs: JobsOption = -1,
    scenario: Annotated[
        list[str] | None, typer.Option(help="Scenario; may be repeated. By default all.")
    ] = None,
) -> None:
    """Run the scenarios with both physics engines, own / mujoco, and compare them."""
    from studies import engines as e
    from tactile_hand_ros.config.paths import scenario_names

    rows = _computed(e.compare, scenario or scenario_names(), out, jobs)
    friction = ("friction", e.FRICTION_COLUMNS, e.friction_rows())
    _finish(out, ("own / mujoco", e.COLUMNS, rows), friction)


app = typer.Typer(
    help="Many runs on all cores, ending in tables.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in (slip, invariance, loads, faults, fuzz, stalls, hands, random_hands, engines):
    app.command()(_command)


def main(words: list[str]) -> int:
    """Run a study and return its exit code."""
    name = "make study"
    return run_command(name, lambda: app(args=words, prog_name=name, standalone_mode=False))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
