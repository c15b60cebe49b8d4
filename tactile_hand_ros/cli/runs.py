# SPDX-License-Identifier: Apache-2.0
"""The commands for a recorded run and its bag: report, summary, replay and recover."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_hand_ros.cli.output import bar, check_writable, print_table
from tactile_hand_ros.errors import TactileHandError, counted

if TYPE_CHECKING:
    from tactile_hand_ros.run.run import Run

RunArgument = Annotated[Path, typer.Argument(help="Folder of a run, or a bag folder or file.")]
NamespaceOption = Annotated[
    str | None, typer.Option(help="Namespace of the hand, if the bag holds several.")
]
LATEST = Path("runs/latest")


def report(
    run: RunArgument = LATEST,
    out: Annotated[Path | None, typer.Option(help="Folder; by default that of the run.")] = None,
    namespace: NamespaceOption = None,
) -> None:
    """Write report.html of a run: 3D playback, plots, metrics."""
    from tactile_hand_ros.report.page import write_report

    if out is not None:
        check_writable(out)
    file = write_report(_open(run, namespace), out)
    print(f"{file}  {1e-6 * file.stat().st_size:.1f} MB")


def summary(run: RunArgument = LATEST, namespace: NamespaceOption = None) -> None:
    """Print what a run achieved, and whether its bag is complete."""
    from tactile_hand_ros.report import tables

    opened = _open(run, namespace)
    if opened.assumptions_problem:
        print(f"note: {opened.assumptions_problem}", file=sys.stderr)
    name = opened.scenario.name if opened.scenario else "unknown scenario"
    columns = ("", "")
    print_table(f"{name}, {opened.path}", columns, tables.metrics_rows(opened.metrics))
    if lines := tables.assumption_rows(opened.assumptions):
        print_table("assumptions", tables.ASSUMPTION_COLUMNS, lines)
    print_table("recording", columns, tables.bag_rows(opened.bag_metrics))


def _open(path: Path, namespace: str | None) -> Run:
    from tactile_hand_ros.run.run import Run

    opened = Run(path, namespace=namespace)
    if opened.scenario_problem:
        text = f"warning: ignoring the recorded scenario: {opened.scenario_problem}"
        print(text, file=sys.stderr)
    return opened


def replay(
    bag: RunArgument = LATEST,
    rate: Annotated[float, typer.Option(metavar="FACTOR", help="Times the original speed.")] = 1.0,
    topics: Annotated[
        list[str] | None,
        typer.Option(help="Regular expression for whole topic names; may be repeated."),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(help="The same, for topics to skip; may be repeated."),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Prefix for the names, such as /left.")] = "",
    recompute: Annotated[
        bool,
        typer.Option("--recompute", help="Rerun the controllers and compare; publish nothing."),
    ] = False,
    law: Annotated[
        str, typer.Option(help="With --recompute: another law, or your own, as MODULE:CLASS.")
    ] = "",
) -> None:
    """Publish a bag as it was recorded, or recompute it. Ctrl-C stops it.

    Exit code of --recompute: 0 if all is the same to the bit, 1 if not. A law of your own is
    imported only if you name it here, by --law MODULE:CLASS.
    """
    if recompute:
        _recompute(bag, namespace, law)
        return
    if law:
        raise TactileHandError("--law is set without --recompute; add --recompute.")
    if not 0.0 < rate < float("inf"):
        raise TactileHandError(f"--rate is {rate}, expected a number above 0.")
    _publish(bag, rate, topics or [".*"], exclude or [], namespace)


def _recompute(bag: Path, namespace: str, law: str) -> None:
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify import recompute as r

    found = r.recompute(Run(bag, namespace=namespace or None), law)
    print_table("recorded and recomputed", r.COLUMNS, [each.row for each in found])
    if not all(each.same for each in found):
        text = "The answers differ: another law, other versions of code or libraries, or lost "
        print(f"{text}messages (see `tactile-hand summary`).", file=sys.stderr)
        raise typer.Exit(1)


def _publish(
    path: Path, rate: float, topics: list[str], exclude: list[str], namespace: str
) -> None:
    from tactile_hand_ros.bag.reader import find_bag

    bag = find_bag(path)
    from tactile_hand_ros.ros.middleware import check_environment, full_namespace

    check_environment(os.environ)  # before rclpy is loaded: it would end the process
    from tactile_hand_ros.nodes.recorder.config import TopicSelection
    from tactile_hand_ros.nodes.replay import replaying

    selection = TopicSelection(topics, exclude)
    place = full_namespace(namespace).rstrip("/")
    with (
        replaying(bag, selection, place) as player,
        bar("replay", player.duration) as update,
    ):

        def watch() -> None:
            done, messages = player.position, counted(player.messages, "message")
            text = f"{done:.1f} of {player.duration:.1f} s, {messages}"
            update(completed=done, description=f"replay: {text}")

        for topic, reason in player.skipped.items():
            print(f"{topic} is not published: {reason}", file=sys.stderr)
        print(f"publishing {len(player.publishers)} topics of {bag}", file=sys.stderr)
        try:
            player.run(rate, watch)
        finally:
            print(f"published {counted(player.messages, 'message')}", file=sys.stderr)


def recover(
    bag: RunArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to create; by default next to the bag.")
    ] = None,
    last: Annotated[float, typer.Option(help="Seconds to keep; 0 keeps all.", min=0.0)] = 0.0,
) -> None:
    """Recover a truncated bag, or copy its last seconds."""
    from tactile_hand_ros.bag import recover as r

    new = r.recover(bag, out, last)
    lost = f"{counted(new.left, 'byte')} could not be used" if new.left else "nothing is lost"
    print(f"recovered {counted(new.metadata.message_count, 'message')} to {new.target}; {lost}")


COMMANDS = (report, summary, recover, replay)
