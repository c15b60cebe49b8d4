# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand`: everything offline. Each command imports what it needs, so that help is fast."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

try:
    import typer
except ModuleNotFoundError:  # the nodes run without it
    sys.exit(
        "tactile-hand needs the Python libraries typer and rich; run `pip install typer rich`."
    )

from tactile_hand_ros.cli_bags import COMMANDS as BAG_COMMANDS
from tactile_hand_ros.core.errors import TactileHandError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from tactile_hand_ros.analysis import Run
    from tactile_hand_ros.bench.results import Result

EXIT_FAILED = 2
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="tactile-hand",
    help="Hold and turn an unknown object with a tactile prosthetic hand: everything offline.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

study_app = typer.Typer(help="Many runs on all cores, ending in figures and a table.")
app.add_typer(study_app, name="study", no_args_is_help=True)

RunArgument = Annotated[
    Path, typer.Argument(help="Folder of a run, or a bag; runs/latest by default.")
]
NamespaceOption = Annotated[
    str | None, typer.Option(help="Namespace of the hand, if the bag holds several.")
]
FormatOption = Annotated[
    list[str] | None,
    typer.Option("--format", help="png, svg or pdf; may be repeated. By default png and svg."),
]
LATEST = Path("runs/latest")


@app.command()
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
    jobs: Annotated[int, typer.Option(help="Number of processes; -1 for one on each core.")] = -1,
    formats: FormatOption = None,
) -> None:
    """Draw the paper's figures and print its claims beside what was measured."""
    from tactile_hand_ros.analysis import tables
    from tactile_hand_ros.analysis.experiments import EXPERIMENTS, LAYOUTS
    from tactile_hand_ros.analysis.reproduce import draw, write
    from tactile_hand_ros.analysis.reproduce import reproduce as run

    layouts = list(dict.fromkeys(layout or LAYOUTS))
    _formats(formats)
    _check_writable(out)
    with _progress("running the paper", len(layouts) * len(EXPERIMENTS)) as advance:
        results = run(layouts, duration, jobs, advance)
    with _progress("drawing", len(results)) as advance:
        files = []
        for result in results:
            files += draw(result, out, _formats(formats))
            advance(result.layout)
    files += write(results, out, _formats(formats)[0])
    for result in results:
        _print(tables.claim_table(f"layout {result.layout}", result.claims))
        title = f"what the laws do, layout {result.layout}"
        _print(tables.rich_table(title, tables.LAW_COLUMNS, tables.law_rows(result.laws)))
    print(f"{len(files)} files in {out}: " + ", ".join(f.name for f in files))


@app.command()
def figures(
    run: RunArgument = LATEST,
    out: Annotated[
        Path | None, typer.Option(help="Folder; by default figures/ in the run.")
    ] = None,
    formats: FormatOption = None,
    namespace: NamespaceOption = None,
) -> None:
    """Draw the paper's Fig. 2, 3 and 4 from a recorded run, as PNG and SVG."""
    from tactile_hand_ros.analysis.figures import friction_figure, motion_figure
    from tactile_hand_ros.analysis.style import save

    opened = _open(run, namespace)
    folder = out or _folder_of(opened) / "figures"
    _check_writable(folder)
    drawn = {"fig3": motion_figure(opened.record), "fig4": friction_figure({"": opened.record})}
    if opened.scenario is not None:
        from tactile_hand_ros.analysis.scene import grasp_figure

        drawn["fig2"] = grasp_figure(opened.record, opened.scenario)
    for name, figure in sorted(drawn.items()):
        for file in save(figure, folder, name, _formats(formats)):
            print(file)
    if opened.scenario is None:
        text = "No scenario is known, so Fig. 2 (hand and object in space) was left out."
        print(text, file=sys.stderr)


@app.command()
def report(
    run: RunArgument = LATEST,
    out: Annotated[Path | None, typer.Option(help="Folder; by default that of the run.")] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Write a run as one page, report.html: 3D playback, plots, metrics, assumptions."""
    from tactile_hand_ros.analysis.report import write_report

    start = time.perf_counter()
    if out is not None:
        _check_writable(out)
    _print_page(write_report(_open(run, namespace), out), start)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two or more runs or bags.")],
    out: Annotated[Path, typer.Option(help="Folder for comparison.html.")] = Path("."),
    namespace: NamespaceOption = None,
) -> None:
    """Lay runs over each other: one page with their plots, and their metrics side by side."""
    from tactile_hand_ros.analysis import tables
    from tactile_hand_ros.analysis.report import COMPARISON, write_comparison

    start = time.perf_counter()
    if len(runs) < 2:
        raise TactileHandError(f"{len(runs)} run was given, expected two or more to compare.")
    _check_writable(out)
    opened = [_open(run, namespace) for run in runs]
    file = write_comparison(opened, out / COMPARISON)
    names = [f"{number}: {each.path.name}" for number, each in enumerate(opened, 1)]
    rows = tables.side_by_side([tables.metrics_rows(each.metrics) for each in opened])
    _print(tables.rich_table("runs", ("", *names), rows))
    _print_page(file, start)


@app.command()
def summary(
    run: RunArgument = LATEST,
    namespace: NamespaceOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what a recorded run achieved, and whether its recording is complete."""
    opened = _open(run, namespace)
    if as_json:
        results = {
            "metrics": opened.metrics.to_dict(),
            "assumptions": [line.to_dict() for line in opened.ledger],
            "bag": opened.bag_metrics.to_dict(),
        }
        print(json.dumps(results, indent=2))
        return
    from tactile_hand_ros.analysis import tables

    name = opened.scenario.name if opened.scenario else "unknown scenario"
    columns = ("", "")
    rows = tables.metrics_rows(opened.metrics) + tables.recovery_rows(opened.recoveries)
    _print(tables.rich_table(f"{name}, {opened.path}", columns, rows))
    if lines := tables.ledger_rows(opened.ledger):
        _print(tables.rich_table("assumptions", tables.LEDGER_COLUMNS, lines))
    _print(tables.rich_table("recording", columns, tables.bag_rows(opened.bag_metrics)))


@app.command()
def scenarios() -> None:
    """List the scenarios of the package."""
    from tactile_hand_ros.analysis import tables
    from tactile_hand_ros.core.scenario import load_scenario, scenario_names

    rows = []
    for name in scenario_names():
        scenario = load_scenario(name)
        rows.append([name, f"{scenario.duration:g} s", scenario.description])
    _print(tables.rich_table("scenarios", ("name", "duration", "description"), rows))


@app.command()
def show(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a YAML file.")],
) -> None:
    """Print a scenario as YAML with every value resolved."""
    from tactile_hand_ros.core.scenario import load_scenario, resolved

    print(resolved(load_scenario(scenario)), end="")


@app.command()
def bench(
    out: Annotated[Path | None, typer.Option(help="File for the results as JSON.")] = None,
    ticks: Annotated[
        int | None, typer.Option(help="Shorter runs, for a quick look.", min=2)
    ] = None,
    repeats: Annotated[int, typer.Option(help="How often whole runs are repeated.", min=1)] = 3,
    blocks: Annotated[
        bool, typer.Option("--blocks", help="Function calls only: no processes, no peers.")
    ] = False,
    realtime: Annotated[
        float | None,
        typer.Option(help="Only real time: how long each way to run is measured [s].", min=1.0),
    ] = None,
    sizes: Annotated[
        bool, typer.Option("--sizes", help="Only the cost against fingers, joints and steps.")
    ] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Folder for figures, with --realtime and --sizes.")
    ] = None,
    formats: FormatOption = None,
) -> None:
    """Measure speed and compare it with the goals."""
    from tactile_hand_ros.analysis import tables
    from tactile_hand_ros.bench.results import COLUMNS, rows, to_json

    _formats(formats)
    for folder in (None if out is None else out.parent, figures):
        if folder is not None:
            _check_writable(folder)
    results: list[Result] = []
    drawn: dict[str, Callable[[], Figure]] = {}
    if realtime is not None:
        results, drawn["realtime"] = _bench_realtime(realtime)
    if sizes:
        costs, drawn["sizes"] = _bench_sizes(ticks, repeats)
        results += costs
    if not drawn:
        results = _bench_all(ticks, repeats, blocks)
    _print(tables.rich_table("bench", COLUMNS, rows(results)))
    if out is not None:
        out.write_text(json.dumps(to_json(results), indent=2) + "\n", encoding="utf-8")
        print(out)
    if figures is not None:
        from tactile_hand_ros.analysis.style import save

        for name, draw in drawn.items():
            print(*save(draw(), figures, name, _formats(formats)))


def _bench_all(ticks: int | None, repeats: int, blocks: bool) -> list[Result]:
    """Measure everything, or what needs no processes."""
    from tactile_hand_ros import bench as b
    from tactile_hand_ros.bench.workload import Workload

    chosen, results = b.BLOCKS if blocks else b.MEASUREMENTS, []
    with _progress("measuring", len(chosen)) as advance:
        work = Workload.prepare(ticks, repeats)
        for measurement in chosen:
            results += list(b.run_measurements(work, [measurement]))
            advance(results[-1].name)
    return results


def _bench_realtime(seconds: float) -> tuple[list[Result], Callable[[], Figure]]:
    """Measure real time in all ways; return results and what draws them."""
    from tactile_hand_ros.bench import realtime as r
    from tactile_hand_ros.bench.figures import realtime_figure

    cases = r.cases()
    with _progress("real time", len(cases)) as advance:
        runs = list(r.run_cases(cases, seconds, advance))
    return r.results(runs), lambda: realtime_figure(runs)


def _bench_sizes(ticks: int | None, repeats: int) -> tuple[list[Result], Callable[[], Figure]]:
    """Measure hands of all sizes; return results and what draws them."""
    from tactile_hand_ros.bench import sizes as s
    from tactile_hand_ros.bench.figures import sizes_figure

    chosen = s.sizes()
    with _progress("sizes", repeats * len(chosen)) as advance:
        costs = s.measure_sizes(chosen, ticks or s.TICKS, repeats, advance)
    return s.results(costs), lambda: sizes_figure(costs)


for _command in BAG_COMMANDS:
    app.command()(_command)


@study_app.callback()
def study() -> None:
    """Many runs on all cores, ending in figures and a table."""


@study_app.command()
def slip(
    out: Annotated[Path, typer.Option(help="Folder for figures, tables and data.")] = Path("study"),
    runs: Annotated[int, typer.Option(help="Number of runs with an event.", min=1)] = 1000,
    jobs: Annotated[int, typer.Option(help="Number of processes; -1 for one on each core.")] = -1,
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    roc: Annotated[
        bool, typer.Option(help="Also replay the detector for its receiver operating curve.")
    ] = False,
    formats: FormatOption = None,
) -> None:
    """Measure how fast slip is found and stopped, and at what squeeze."""
    from tactile_hand_ros.analysis import (
        roc_figure,
        slip_roc,
        slip_study,
        study_figures,
        tables,
    )
    from tactile_hand_ros.analysis import study_tables as s
    from tactile_hand_ros.analysis.style import save

    _formats(formats)
    _check_writable(out if out.exists() else out.absolute().parent)
    with _progress("holding", len(slip_study.tasks_of(runs, seed))) as advance:
        result = slip_study.run_study(runs, seed, jobs, advance)
    drawn = study_figures.figures(result)
    points: list[slip_roc.Point] = []
    if roc:
        with _progress("replaying", slip_roc.steps(slip_roc.SLIPS)) as advance:
            points = slip_roc.run_roc(seed=seed, jobs=jobs, progress=advance)
        drawn["study_roc"] = roc_figure.roc_figure(points)
    files = s.write(result, out)
    if points:
        files += slip_roc.write(points, out)
    for name, figure in drawn.items():
        files += save(figure, out, name, _formats(formats))
    _print(tables.rich_table(f"slip, {runs} runs", s.COLUMNS, s.rows(result)))
    _print(tables.rich_table("how often", s.SHARE_COLUMNS, s.share_rows(result)))
    if points:
        _print(tables.rich_table("detector", slip_roc.COLUMNS, slip_roc.rows(points)))
    print(f"{len(files)} files in {out}: " + ", ".join(f.name for f in files))


def _formats(given: list[str] | None) -> tuple[str, ...]:
    """Return the formats of figures.

    Raises:
        TactileHandError: If one is unknown.
    """
    unknown = set(given or ()) - {"png", "svg", "pdf"}
    if unknown:
        raise TactileHandError(f"Format is '{unknown.pop()}', expected png, svg or pdf.")
    return tuple(dict.fromkeys(given or ("png", "svg")))


def _open(path: Path, namespace: str | None) -> Run:
    from tactile_hand_ros.analysis import Run

    opened = Run(path, namespace=namespace)
    if opened.scenario_problem:
        text = f"note: without its scenario, which does not fit: {opened.scenario_problem}"
        print(text, file=sys.stderr)
    return opened


def _print_page(file: Path, start: float) -> None:
    """Say where a page is, how large, and how long it took since `start`."""
    size, took = 1e-6 * file.stat().st_size, time.perf_counter() - start
    _console().print(
        f"[bold]{_escaped(file)}[/bold]  {size:.1f} MB in {took:.1f} s", soft_wrap=True
    )


def _escaped(text: object) -> str:
    from rich.markup import escape

    return escape(str(text))


def _folder_of(run: Run) -> Path:
    """Return where results of a run belong: the run's folder, or beside a bare bag."""
    return run.path if run.bag != run.path else run.bag.parent


def _check_writable(folder: Path) -> None:
    """Create a folder for results, before any work is done for it.

    Raises:
        TactileHandError: If that is not possible.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError as error:
        reason = error.strerror
    else:
        reason = "" if writable else "it is read-only"
    if reason:
        raise TactileHandError(f"Nothing can be written to {folder} ({reason}); choose another.")


def _console(stderr: bool = False) -> Console:
    from rich.console import Console

    console = Console(stderr=stderr)
    if not console.is_terminal:
        console.width = 140  # of a file or pipe nothing is known; do not squeeze tables into 80
    return console


def _print(table: object) -> None:
    _console().print(table)


class _progress:
    """A bar on the terminal while something goes on; nothing when nobody looks."""

    def __init__(self, title: str, total: int) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
        from rich.progress import TimeElapsedColumn as Elapsed

        console = _console(stderr=True)
        texts = TextColumn("{task.description}"), TextColumn("{task.fields[latest]}")
        self._bar = Progress(
            texts[0],
            BarColumn(),
            MofNCompleteColumn(),
            Elapsed(),
            texts[1],
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task(title, total=total, latest="")

    def __enter__(self) -> _progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, latest: str) -> None:
        """Advance by one and tell what was done."""
        self._bar.update(self._task, advance=1, latest=latest)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Args:
        arguments: Command line without the program's name; None takes ``sys.argv``.

    Returns:
        0 after success, 2 when something was refused (one sentence on stderr), 130 after Ctrl-C.
    """
    try:
        code = app(
            args=list(sys.argv[1:] if arguments is None else arguments),
            prog_name="tactile-hand",
            standalone_mode=False,
        )
        sys.stdout.flush()
    except TactileHandError as error:
        print(f"tactile-hand: {error}", file=sys.stderr)
        return EXIT_FAILED
    except (KeyboardInterrupt, typer.Abort):
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _refused_usage(error)
    return code if isinstance(code, int) else 0


def _refused_usage(error: Exception) -> int:
    """Show what is wrong with the command line; anything else is a defect and is raised again."""
    if not hasattr(error, "format_message") or not hasattr(error, "exit_code"):
        raise error
    usage = cast(Any, error)
    if message := usage.format_message():  # without any argument help was printed instead
        print(f"tactile-hand: {message} See `tactile-hand --help`.", file=sys.stderr)
    return int(usage.exit_code)


if __name__ == "__main__":
    sys.exit(main())
