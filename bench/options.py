# SPDX-License-Identifier: Apache-2.0
"""The options of `make bench`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import FormatOption

FOLDER = Path("runs/bench")


@dataclass(frozen=True)
class BenchOptions:
    """The options of `make bench`."""

    out: Annotated[
        Path | None,
        typer.Option(help=f"File for the results; by default one of each kind in {FOLDER}."),
    ] = None
    ticks: Annotated[int | None, typer.Option(help="Shorter runs, for a quick look.", min=2)] = None
    repeats: Annotated[int, typer.Option(help="How often whole runs are repeated.", min=1)] = 3
    blocks: Annotated[
        bool, typer.Option("--blocks", help="Function calls only: no processes, no peers.")
    ] = False
    sizes: Annotated[
        bool, typer.Option("--sizes", help="Only the cost against fingers, joints and steps.")
    ] = False
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Only real time: which rate is sustained?")
    ] = False
    rates: Annotated[
        str, typer.Option(help="Rates for --realtime and --scenarios [Hz], as 250,500,1000.")
    ] = ""
    seconds: Annotated[
        float, typer.Option(help="With --realtime, length of each run [s].", min=1.0)
    ] = 20.0
    loaded: Annotated[
        bool, typer.Option("--loaded", help="With --realtime, also beside a busy loop per core.")
    ] = False
    soak: Annotated[
        float | None,
        typer.Option(help="Only a long run in real time, composed and in processes [s].", min=5.0),
    ] = None
    scenarios: Annotated[
        str, typer.Option(help="Only scenarios in lockstep and in real time: all, or pull,gravity.")
    ] = ""
    runs: Annotated[int, typer.Option(help="With --scenarios, runs of each case.", min=1)] = 10
    duration: Annotated[
        float | None, typer.Option(help="With --scenarios, simulated time [s].", min=0.1)
    ] = None
    priority: Annotated[
        int,
        typer.Option(help="With --scenarios and --soak, priority under SCHED_FIFO.", min=0, max=99),
    ] = 0
    limit: Annotated[
        float, typer.Option(help="With --scenarios, begin no run after so long [min].", min=0.0)
    ] = 600.0
    fresh: Annotated[
        bool, typer.Option("--fresh", help="With --scenarios, forget the runs that are kept.")
    ] = False
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print tables as Markdown, for a page.")
    ] = False
    figures: Annotated[
        Path | None, typer.Option(help="Folder for figures, with --realtime and --sizes.")
    ] = None
    formats: FormatOption = None

    @property
    def kind(self) -> str:
        """What is measured.

        Raises:
            typer.BadParameter: If several kinds are asked for.
        """
        asked = {
            "blocks": self.blocks,
            "sizes": self.sizes,
            "realtime": self.realtime,
            "soak": self.soak is not None,
            "scenarios": bool(self.scenarios),
        }
        chosen = [name for name, is_asked in asked.items() if is_asked]
        if len(chosen) > 1:
            raise typer.BadParameter(f"--{chosen[0]} and --{chosen[1]} are measured separately.")
        return chosen[0] if chosen else "bench"

    @property
    def file(self) -> Path:
        """Where the results are kept.

        Raises:
            typer.BadParameter: If several kinds are asked for.
        """
        kind = self.kind
        return self.out or FOLDER / f"{kind}.{'jsonl' if self.scenarios else 'json'}"
