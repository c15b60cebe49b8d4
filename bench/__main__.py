# SPDX-License-Identifier: Apache-2.0
"""`make bench`: one table of what is measured, beside the targets."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

if __name__ == "__main__":
    # Behind the installed package, which is what is measured; also for the processes it starts.
    sys.path[0:1] = []
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

import typer

from tactile_hand_ros.cli.output import check_writable, print_table, steps
from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.report.tables import markdown as as_markdown
from tactile_hand_ros.report.tables import rich_table

if TYPE_CHECKING:
    from bench.result import Measurement
    from bench.workload import Workload

SECTIONS = ("blocks", "lockstep", "start", "realtime")


def bench(
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SECTIONS)}, joined by commas.")
    ] = ",".join(SECTIONS),
    repeats: Annotated[int, typer.Option(help="How often whole runs are repeated.", min=1)] = 5,
    ticks: Annotated[int | None, typer.Option(help="Shorter runs in lockstep.", min=2)] = None,
    rates: Annotated[str, typer.Option(help="Rates in real time [Hz].")] = "500,1000",
    seconds: Annotated[
        float, typer.Option(help="Length of each run in real time [s].", min=1.0)
    ] = 20.0,
    out: Annotated[Path, typer.Option(help="File for the results.")] = Path("runs/bench.json"),
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table as Markdown, for a page.")
    ] = False,
) -> None:
    """Measure speed, start and missed deadlines, and save the results."""
    from bench.result import COLUMNS, to_json
    from bench.workload import Workload

    chosen, hertz = _chosen(only), parse_rates(rates)
    if out.is_dir():
        raise ConfigurationError(f"--out: {out} is a folder, expected the name of a file.")
    check_writable(out.parent)
    results: list[Measurement] = []
    with steps("measuring", len(chosen)) as advance:
        work = Workload.prepare(ticks, repeats, seconds, hertz)
        for name in chosen:
            results += _measure(name, work)
            advance(name)
    rows = [result.row for result in results]
    if markdown:
        print(as_markdown(COLUMNS, rows))
    else:
        print_table(rich_table("measurements", COLUMNS, rows))
    replace_text(out, json.dumps(to_json(results), indent=2) + "\n")
    print(f"saved in {out}")


def _measure(name: str, work: Workload) -> list[Measurement]:
    from bench import blocks, graph

    measurements = {
        "blocks": (blocks.measure_loop, blocks.measure_blocks),
        "lockstep": (graph.measure_lockstep,),
        "start": (graph.measure_short_run,),
        "realtime": (graph.measure_real_time,),
    }
    return [result for measure in measurements[name] for result in measure(work)]


def _chosen(text: str) -> list[str]:
    chosen = text.split(",")
    for name in chosen:
        if name not in SECTIONS:
            raise ConfigurationError(f"--only is '{text}', expected some of {', '.join(SECTIONS)}.")
    return chosen


def parse_rates(text: str) -> tuple[float, ...]:
    """Read rates such as ``250,500,1000``, Hz.

    Raises:
        ConfigurationError: If one is not a number from 1 to 10000.
    """
    try:
        rates = tuple(sorted({float(word) for word in text.split(",")}))
    except ValueError:
        rates = (0.0,)
    if not all(1.0 <= rate <= 10_000.0 for rate in rates):
        raise ConfigurationError(
            f"--rates is '{text}', expected ticks per second from 1 to 10000, such as 250,500,1000."
        )
    return rates


def main(words: list[str]) -> int:
    """Run the benchmark and return its exit code."""
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(bench)
    name = "make bench"
    return run_command(name, lambda: app(args=words, prog_name=name, standalone_mode=False))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
