# SPDX-License-Identifier: Apache-2.0
"""`make bench`: how fast everything is, which rate is sustained, and what that does."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# Behind the installed package, which is what is measured; also for the processes that are started.
if __name__ == "__main__":
    sys.path[0:1] = []
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

import typer

from bench.options import BenchOptions
from tactile_hand_ros.cli.output import Progress, check_file, check_writable, figure_formats
from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.command_options import with_options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bench.realtime.cases import RealtimeRun
    from bench.realtime.outcomes import Outcome
    from bench.results import Result

_INTERRUPTED = 130


@with_options
def bench(options: BenchOptions) -> None:
    """Measure speed, compare it with the goals and with the last run, and save it."""
    formats = figure_formats(options.formats)
    check_file(options.file)
    if options.figures is not None:
        check_writable(options.figures)
    show = _markdown_table if options.markdown else _terminal_table
    if options.scenarios:
        _bench_scenarios(options, show)
        return
    draw: Callable[[], Figure] | None = None
    if options.realtime:
        results, draw = _bench_realtime(options, show)
    elif options.sizes:
        results, draw = _bench_sizes(options.ticks, options.repeats)
    elif options.soak is not None:
        results = _bench_soak(options.soak, options.priority)
    else:
        results = _bench_all(options.ticks, options.repeats, options.blocks)
    _finish(results, options.file, show, in_full=not options.realtime)
    if options.figures is not None and draw is not None:
        from tactile_hand_ros.report.style import save

        print(*save(draw(), options.figures, options.kind, formats))


def _log(line: str) -> None:
    """Say what is done where no bar shows it."""
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


Show = Callable[[str, Sequence[str], Sequence[Sequence[str]]], None]


def _terminal_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console

    from bench.page import WIDTH
    from tactile_hand_ros.report.tables import rich_table

    table = rich_table(title, columns, rows)
    table.box = SIMPLE_HEAD
    Console(width=WIDTH).print(table)


def _markdown_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from tactile_hand_ros.report.tables import markdown

    print(f"{title}\n\n{markdown(columns, rows)}")


def _finish(results: Sequence[Result], file: Path, show: Show, *, in_full: bool) -> None:
    """Show goals, and in full all results, beside those of the last run, and save them."""
    from bench import comparison, page
    from bench.blocks import function_calls

    saved, calls = comparison.load(file), function_calls()
    goals = page.goal_rows(results, saved)
    if goals:
        show("goals", page.GOAL_COLUMNS, goals)
    for title, some in page.sections(results).items() if in_full else ():
        show(title or "measurements", page.COLUMNS, page.rows(some, saved))
    print(comparison.speed_line(calls, saved))
    comparison.save(results, calls, file)
    print(f"saved in {file}")


def _bench_all(ticks: int | None, repeats: int, blocks: bool) -> list[Result]:
    """Measure everything, or what needs no processes."""
    import bench as b
    from bench.workload import Workload

    chosen, results = b.BLOCKS if blocks else b.MEASUREMENTS, []
    with Progress("measuring", len(chosen)) as advance:
        work = Workload.prepare(ticks, repeats)
        for measurement in chosen:
            results += list(b.run_measurements(work, [measurement]))
            advance(results[-1].name)
    return results


def _bench_realtime(options: BenchOptions, show: Show) -> tuple[list[Result], Callable[[], Figure]]:
    """Measure which rates are sustained; return results and what draws them."""
    from bench.figures import realtime_figure
    from bench.realtime import cases as r
    from bench.realtime import rates as table

    asked = table.parse_rates(options.rates) if options.rates else r.RATES
    cases = r.cases(asked, loaded=options.loaded)
    runs: list[RealtimeRun] = []
    with Progress("real time", len(cases)) as advance:
        try:
            for run in r.run_cases(cases, options.seconds, advance):
                runs.append(run)
                _log(f"{len(runs)} of {len(cases)}: {run.case}")
        except KeyboardInterrupt:
            print("stopped; this is what was measured until then", file=sys.stderr)
    show("which rate is sustained", table.COLUMNS, table.rows(runs))
    show("why ticks were missed", table.CAUSE_COLUMNS, table.cause_rows(runs))
    print(table.recommendation(runs))
    return r.results(runs), lambda: realtime_figure(runs)


def _bench_soak(seconds: float, priority: int) -> list[Result]:
    """Run for a long time at 500 Hz in one process, then at 250 Hz in six."""
    from bench import soak as s

    results: list[Result] = []
    for where, rate, composed in (("composed", 500.0, True), ("processes", 250.0, False)):
        with Progress(f"soak, {where}", 2 * round(seconds)) as advance:
            seen = s.soak(
                s.soak_scenario(rate),
                seconds,
                composed=composed,
                priority=priority,
                progress=advance,
            )
        results += s.results(seen, where)
    return results


def _bench_sizes(ticks: int | None, repeats: int) -> tuple[list[Result], Callable[[], Figure]]:
    """Measure hands of all sizes; return results and what draws them."""
    from bench import sizes as s
    from bench.figures import sizes_figure

    chosen = s.sizes()
    with Progress("sizes", repeats * len(chosen)) as advance:
        costs = s.measure_sizes(chosen, ticks or s.TICKS, repeats, advance)
    return s.results(costs), lambda: sizes_figure(costs)


def _bench_scenarios(options: BenchOptions, show: Show) -> None:
    """Run scenarios until all is done, the time is over, or Ctrl-C, and show what there is."""
    from bench.realtime import outcomes as o
    from bench.realtime.rates import parse_rates
    from bench.realtime.schedule import planned, run_planned
    from tactile_hand_ros.scenario.scenario import scenario_names

    names, file = options.scenarios, options.file
    chosen = scenario_names() if names == "all" else names.split(",")
    rates = parse_rates(options.rates) if options.rates else []
    cases = o.scenario_cases(chosen, rates, options.duration, options.priority)
    plan = planned(cases, options.runs)
    if options.fresh:
        file.unlink(missing_ok=True)
    done: list[Outcome] = []
    stopped = False
    with Progress("scenarios", len(plan)) as advance:
        try:
            for outcome in run_planned(plan, file, 60.0 * options.limit, advance):
                done.append(outcome)
                _log(f"{len(done)} of {len(plan)}: {outcome}")
        except KeyboardInterrupt:
            stopped = True
    show("scenarios", o.COLUMNS, o.rows(done))
    if done:
        print(o.calls_line(done))
    if len(done) < len(plan):
        print(f"{len(done)} of {len(plan)} runs are done and kept in {file}; repeat to go on")
    if stopped:
        raise typer.Exit(_INTERRUPTED)


def main(words: list[str]) -> int:
    """Run a benchmark and return its exit code."""
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(bench)
    name = "make bench"
    return run_command(name, lambda: app(args=words, prog_name=name, standalone_mode=False))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
