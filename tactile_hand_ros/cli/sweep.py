# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand sweep`: a scenario over any of its parameters, on one machine or on a cluster."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_hand_ros.cli.output import (
    FormatOption,
    JobsOption,
    SeedOption,
    check_writable,
    console,
    figure_formats,
    print_table,
)
from tactile_hand_ros.command_options import with_options
from tactile_hand_ros.errors import TactileHandError

if TYPE_CHECKING:
    from tactile_hand_ros.sweep.sweep import Sweep
    from tactile_hand_ros.sweep.table import Tally

ClusterOption = Annotated[
    str, typer.Option(help="Dask scheduler, as tcp://127.0.0.1:8786, or its scheduler file.")
]

_LOOK = 0.2  # s between two looks at the progress


@dataclass(frozen=True)
class SweepOptions:
    """The options of `tactile-hand sweep`."""

    targets: Annotated[
        list[str],
        typer.Argument(metavar="SCENARIO...", help="Scenarios, or the folder of a study."),
    ]
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
            help="outcome, slip, error, peak_force, margin, settling_time or module:function; may "
            "be repeated. By default all that have a name."
        ),
    ] = field(default_factory=list)
    seed: SeedOption = 0
    jobs: JobsOption = -1
    cluster: ClusterOption = ""
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("sweep")
    rerun: Annotated[
        int | None, typer.Option(help="Replay one run of a study as a recorded run, by its number.")
    ] = None
    formats: FormatOption = None

    @property
    def folder(self) -> Path:
        """Where the results are: the folder of a study where one is given."""
        return Path(self.targets[0]) if self.goes_on else self.out

    @property
    def goes_on(self) -> bool:
        """Whether the target is the folder of a study that is there already."""
        return len(self.targets) == 1 and (Path(self.targets[0]) / "study.json").is_file()

    def asked(self) -> Sweep:
        """Return what is asked for.

        Raises:
            TactileHandError: If the options do not go together, or a value is refused.
        """
        from tactile_hand_ros.config.plain_yaml import parse_changes
        from tactile_hand_ros.sweep.metrics import METRICS
        from tactile_hand_ros.sweep.sweep import make_sweep, read_sweep

        if self.goes_on:
            if self.over or self.changes or self.metric:
                raise TactileHandError(
                    f"{self.folder} is the folder of a study, which says what it varies; leave "
                    "--over, --set and --metric away."
                )
            return read_sweep(self.folder)
        if self.rerun is not None:
            raise TactileHandError("--rerun was given, expected the folder of a study before it.")
        return make_sweep(
            self.targets,
            self.over,
            parse_changes(self.changes),
            self.metric or list(METRICS),
            sampler=self.sampler,
            runs=self.runs,
            seed=self.seed,
        )


@with_options
def sweep(options: SweepOptions) -> None:
    """Run scenarios over ranges of their parameters; table, summary and figures.

    Give the folder of a study alone to go on with it, with --rerun to replay one of its runs.
    """
    formats = figure_formats(options.formats)
    asked, folder = options.asked(), options.folder
    if options.rerun is not None:
        raise typer.Exit(_rerun(asked, folder, options.rerun))
    check_writable(folder)
    _run(asked, folder, options.jobs, options.cluster)
    _show(asked, folder, formats)


def _run(asked: Sweep, out: Path, jobs: int, cluster: str) -> None:
    from tactile_hand_ros.sweep.engine import workers

    with workers(jobs, cluster), progress(", ".join(asked.scenarios)) as watch:
        try:
            tally = asked.carry_out(out, watch)
        except KeyboardInterrupt:
            print(f"interrupted; {_again(out)}", file=sys.stderr)
            raise
        except TactileHandError as error:
            raise TactileHandError(f"{error} {_again(out)}") from None
    failed = tally.outcomes["failed"]
    print(f"{tally.done} of {tally.total} runs, {failed} failed, {tally.rate:.3g} runs/s")


def _again(out: Path) -> str:
    return f"What is done is in {out}; `tactile-hand sweep {out}` goes on."


@contextlib.contextmanager
def progress(title: str) -> Iterator[Callable[[Tally], None]]:
    """Show how far a study is, on a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    output = console(stderr=True)
    texts = TextColumn("{task.fields[left]}"), TextColumn("{task.fields[state]}")
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(20),
        MofNCompleteColumn(),
        *texts,
        console=output,
        transient=True,
        disable=not output.is_terminal,
    )
    task = bar.add_task(title, total=None, left="", state="starting")
    last = 0.0

    def watch(tally: Tally) -> None:
        nonlocal last
        if time.monotonic() - last < _LOOK:
            return
        last = time.monotonic()
        left = f"{_clock(tally.left)} left"
        bar.update(task, completed=tally.done, total=tally.total, left=left, state=str(tally))

    with bar:
        yield watch


def _clock(seconds: float) -> str:
    if not seconds < 1e7:
        return "an unknown time"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _show(asked: Sweep, out: Path, formats: tuple[str, ...]) -> None:
    from tactile_hand_ros.report.style import save
    from tactile_hand_ros.report.tables import rich_table
    from tactile_hand_ros.sweep import tables
    from tactile_hand_ros.sweep.figures import figures
    from tactile_hand_ros.sweep.results import each_scenario

    results = each_scenario(asked, out)
    pictures = []
    for each in results:
        for name, figure in figures(each).items():
            pictures.append(save(figure, out, name, formats)[0])
    page = tables.write(results, out, pictures)
    print_table(rich_table("outcomes", tables.FRACTION_COLUMNS, tables.fraction_rows(results)))
    print_table(rich_table("metrics", tables.METRIC_COLUMNS, tables.metric_rows(results)))
    if rows := tables.effect_rows(results):
        print_table(rich_table("what it depends on most", tables.EFFECT_COLUMNS, rows[:10]))
    print(f"{page}, runs.parquet, runs.csv and {len(pictures)} figures")


def _rerun(asked: Sweep, folder: Path, index: int) -> int:
    """Replay one run through the nodes, recorded, with the values that it had."""
    from tactile_hand_ros import files
    from tactile_hand_ros.scenario.scenario import resolved
    from tactile_hand_ros.sweep.engine import build
    from tactile_hand_ros.sweep.table import read_description

    point = asked.study.point(index)
    scenario = asked.trial.scenario(point)
    before = read_description(folder)["build"]
    if before != build():
        text = f"note: the study was made by {before}, this is {build()}: results may differ."
        print(text, file=sys.stderr)
    values: dict[str, Any] = asked.trial.changes(point)[1]
    listed = " ".join(f"{path}={json.dumps(value)}" for path, value in values.items())
    print(f"run {index}: {listed}", flush=True)
    file = folder / f"run_{index}.yaml"
    files.replace_text(file, resolved(scenario))
    command = [sys.executable, "-m", "tactile_hand_ros.ros.processes", "orchestrator"]
    options = ["--scenario", str(file), "--out", str(folder / "runs")]
    # What else this computer does may be the study itself.
    return subprocess.run([*command, *options, "--startup-timeout", "120"]).returncode


COMMANDS = (sweep,)
