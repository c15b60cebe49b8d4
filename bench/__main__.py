# SPDX-License-Identifier: Apache-2.0
"""`make bench`: one table of measurements and targets."""

from __future__ import annotations

import enum
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

if __name__ == "__main__":
    # Append, so that the installed package is measured, in child processes too.
    sys.path[0:1] = []
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

import typer

from tactile_hand_ros.cli.output import check_writable, print_table, steps
from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.files import replace_text

if TYPE_CHECKING:
    from bench.result import Measurement
    from bench.workload import Workload


class Section(str, enum.Enum):
    """Sections of the benchmark."""

    BLOCKS = "blocks"
    LOCKSTEP = "lockstep"
    START = "start"
    REALTIME = "realtime"


def bench(
    only: Annotated[
        list[Section] | None, typer.Option(help="May be repeated; by default all.")
    ] = None,
    repeats: Annotated[int, typer.Option(help="Number of repetitions of whole runs.", min=1)] = 5,
    ticks: Annotated[int | None, typer.Option(help="Shorter runs in lockstep.", min=2)] = None,
    rate: Annotated[
        list[float] | None,
        typer.Option(
            help="In real time [Hz]; may be repeated, by default 500 and 1000.", min=1, max=1e4
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(help="Length of each run in real time [s].", min=1.0)
    ] = 20.0,
    out: Annotated[Path, typer.Option(help="File for the results.")] = Path("runs/bench.json"),
) -> None:
    """Measure speed, startup and missed deadlines, and save the results."""
    from bench.result import COLUMNS, to_json
    from bench.workload import Workload
    from tactile_hand_ros.closed_loop.loop import ClosedLoop
    from tactile_hand_ros.scenario.scenario import load_scenario

    chosen = only or list(Section)
    if out.is_dir():
        raise ConfigurationError(f"--out: {out} is a folder, expected a file name.")
    check_writable(out.parent)
    results: list[Measurement] = []
    with steps("measuring", len(chosen)) as advance:
        scenario, rates = load_scenario("paper"), tuple(rate or (500.0, 1000.0))
        work = Workload(scenario, ClosedLoop(scenario).run(ticks), repeats, seconds, rates)
        for name in chosen:
            results += _measure(name, work)
            advance(name.value)
    print_table("measurements", COLUMNS, [result.row for result in results])
    replace_text(out, json.dumps(to_json(results), indent=2) + "\n")
    print(f"saved in {out}")


def _measure(section: Section, work: Workload) -> list[Measurement]:
    from bench import blocks, graph

    measurements = {
        Section.BLOCKS: (blocks.measure_loop, blocks.measure_blocks),
        Section.LOCKSTEP: (graph.measure_lockstep,),
        Section.START: (graph.measure_short_run,),
        Section.REALTIME: (graph.measure_real_time,),
    }
    return [result for measure in measurements[section] for result in measure(work)]


def main(words: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(bench)
    name = "make bench"
    return run_command(name, lambda: app(args=words, prog_name=name, standalone_mode=False))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
