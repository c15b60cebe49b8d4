# SPDX-License-Identifier: Apache-2.0
"""What a recorded run shows, and its bag: published, recomputed or repaired."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_hand_ros.cli.output import (
    EXIT_DIFFERS,
    BagArgument,
    NamespaceOption,
    bar,
    check_writable,
    console,
    print_table,
)
from tactile_hand_ros.command_options import with_options
from tactile_hand_ros.errors import TactileHandError, counted

if TYPE_CHECKING:
    from tactile_hand_ros.run.run import Run

RunArgument = Annotated[
    Path, typer.Argument(help="Folder of a run, or a bag; runs/latest by default.")
]
LATEST = Path("runs/latest")


def figures(
    run: RunArgument = LATEST,
    out: Annotated[
        Path | None, typer.Option(help="Folder; by default figures/ in the run.")
    ] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Draw the paper's Fig. 2, 3 and 4 from a recorded run, as PNG and SVG."""
    from tactile_hand_ros.report.figures import friction_figure, motion_figure
    from tactile_hand_ros.report.style import save

    opened = _open(run, namespace)
    folder = out or opened.folder / "figures"
    check_writable(folder)
    drawn = {"fig3": motion_figure(opened.record), "fig4": friction_figure({"": opened.record})}
    if opened.scenario is not None:
        from tactile_hand_ros.report.scene import grasp_figure

        drawn["fig2"] = grasp_figure(opened.record, opened.scenario)
    for name, figure in sorted(drawn.items()):
        for file in save(figure, folder, name):
            print(file)
    if opened.scenario is None:
        text = "No scenario is known, so Fig. 2 (hand and object in space) was left out."
        print(text, file=sys.stderr)


def report(
    run: RunArgument = LATEST,
    out: Annotated[Path | None, typer.Option(help="Folder; by default that of the run.")] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Write a run as one page, report.html: 3D playback, plots, metrics, assumptions."""
    from tactile_hand_ros.report.page import write_report

    if out is not None:
        check_writable(out)
    _print_page(write_report(_open(run, namespace), out))


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two or more runs or bags.")],
    out: Annotated[Path, typer.Option(help="Folder for comparison.html.")] = Path("."),
    namespace: NamespaceOption = None,
) -> None:
    """Lay runs over each other: one page with their plots, and their metrics side by side."""
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.report.facts import differing, labels
    from tactile_hand_ros.report.page import COMPARISON, write_comparison

    if len(runs) < 2:
        raise TactileHandError(f"{len(runs)} run was given, expected two or more to compare.")
    check_writable(out)
    opened = [_open(run, namespace) for run in runs]
    file = write_comparison(opened, out / COMPARISON)
    names = [f"{number}: {label}" for number, label in enumerate(labels(opened), 1)]
    if settings := differing(opened):
        print_table("settings that differ", ("", *names), settings)
    rows = [["", *(each.headline for each in opened)]]
    rows += tables.side_by_side([tables.metrics_rows(each.metrics) for each in opened])
    print_table("runs", ("", *names), rows)
    _print_page(file)


def summary(
    run: RunArgument = LATEST,
    namespace: NamespaceOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what a recorded run achieved, and whether its recording is complete."""
    opened = _open(run, namespace)
    if opened.assumptions_problem:
        print(f"note: {opened.assumptions_problem}", file=sys.stderr)
    if as_json:
        results = {
            "metrics": opened.metrics.to_dict(),
            "assumptions": [line.to_dict() for line in opened.assumptions],
            "bag": opened.bag_metrics.to_dict(),
        }
        print(json.dumps(results, indent=2))
        return
    from tactile_hand_ros.report import tables

    name = opened.scenario.name if opened.scenario else "unknown scenario"
    columns = ("", "")
    rows = tables.metrics_rows(opened.metrics) + tables.recovery_rows(opened.recoveries)
    print_table(f"{name}, {opened.path}", columns, rows)
    if lines := tables.assumption_rows(opened.assumptions):
        print_table("assumptions", tables.ASSUMPTION_COLUMNS, lines)
    print_table("recording", columns, tables.bag_rows(opened.bag_metrics))


def _open(path: Path, namespace: str | None) -> Run:
    from tactile_hand_ros.run.run import Run

    opened = Run(path, namespace=namespace)
    if opened.scenario_problem:
        text = f"note: without its scenario, which does not fit: {opened.scenario_problem}"
        print(text, file=sys.stderr)
    return opened


def _print_page(file: Path) -> None:
    """Print where a page is, and its size."""
    console().print(f"{file}  {1e-6 * file.stat().st_size:.1f} MB", soft_wrap=True, markup=False)


@dataclass(frozen=True)
class ReplayRequest:
    """The options of `tactile-hand replay`."""

    bag: BagArgument = Path("runs/latest")
    rate: Annotated[float, typer.Option(help="Times the original speed.")] = 1.0
    topics: Annotated[
        list[str],
        typer.Option(help="Only topics whose whole name matches; may be repeated."),
    ] = field(default_factory=list)
    exclude: Annotated[
        list[str],
        typer.Option(help="Not the topics whose whole name matches; may be repeated."),
    ] = field(default_factory=list)
    namespace: Annotated[str, typer.Option(help="Put before the names, as /left.")] = ""
    recompute: Annotated[
        bool,
        typer.Option("--recompute", help="Publish nothing: ask the controllers again, compare."),
    ] = False
    changes: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="KEY=VALUE", help="With --recompute: another value of the scenario."
        ),
    ] = field(default_factory=list)


@with_options
def replay(request: ReplayRequest) -> None:
    """Publish a bag as it was recorded, or recompute it. Ctrl-C stops it.

    Exit code of --recompute as recorded: 0 if all is the same to the bit, 1 if not. A law of your
    own is imported only if you name it here, by --set law=MODULE:CLASS.
    """
    if request.recompute:
        _recompute(request)
        return
    if request.changes:
        raise TactileHandError("--set was given, expected --recompute too.")
    from tactile_hand_ros.bag.reader import find_bag

    if not 0.0 < request.rate < float("inf"):
        raise TactileHandError(f"--rate is {request.rate}, expected a number above 0.")
    _publish(find_bag(request.bag), request)


def _recompute(request: ReplayRequest) -> None:
    """Ask the controllers again, and compare their answers with those in the bag."""
    from tactile_hand_ros.config.plain_yaml import parse_changes
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify import recompute as r

    run = Run(request.bag, namespace=request.namespace or None)
    values = parse_changes(request.changes, "force_optimizer.cones=false")
    recorded = {"law": r.scenario_of(run).manipulation_controller.law.name}
    result = r.recompute(run, values)
    print_table("recorded and recomputed", r.COLUMNS, [each.row for each in result.comparisons])
    if values in ({}, recorded) and not result.same:
        text = "The same configuration gave other answers: messages were lost, see `tactile-hand "
        print(f"{text}summary`, or code or libraries are of other versions.", file=sys.stderr)
        raise typer.Exit(EXIT_DIFFERS)


def _publish(bag: Path, request: ReplayRequest) -> None:
    try:
        from tactile_hand_ros.bag.selection import TopicSelection
        from tactile_hand_ros.nodes.replay import replaying
        from tactile_hand_ros.ros.middleware import full_namespace
    except ModuleNotFoundError as error:
        raise TactileHandError(
            f"Replay publishes in ROS, but there is no module '{error.name}'; source ROS 2 or "
            "install its wheels."
        ) from None

    selection = TopicSelection(request.topics or [".*"], request.exclude)
    namespace = full_namespace(request.namespace).rstrip("/")
    with (
        replaying(bag, selection, namespace) as player,
        bar("replay", player.duration) as update,
    ):

        def watch() -> None:
            done, messages = player.position, counted(player.messages, "message")
            text = f"{done:.1f} of {player.duration:.1f} s, {messages}"
            update(completed=done, text=text)

        for topic, reason in player.skipped.items():
            print(f"{topic} is not published: {reason}", file=sys.stderr)
        print(f"publishing {len(player.publishers)} topics of {bag}", file=sys.stderr)
        try:
            player.run(request.rate, watch)
        finally:
            print(f"published {counted(player.messages, 'message')}", file=sys.stderr)


def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to create; by default next to the bag.")
    ] = None,
) -> None:
    """Recover a bag that was cut off, from any recorder."""
    from tactile_hand_ros.bag import recover as r
    from tactile_hand_ros.bag.reader import find_bag

    found = find_bag(bag)
    if out is None and r.is_whole(found):
        print(f"{found} is whole, there is nothing to recover")
        return
    new = r.recover(found, out)
    lost = f"{counted(new.left, 'byte')} could not be used" if new.left else "nothing is lost"
    print(f"recovered {counted(new.messages, 'message')} to {new.target}; {lost}")


COMMANDS = (figures, report, compare, summary, recover, replay)
