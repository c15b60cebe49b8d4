# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand recover`, `replay` and `audit`: what is done to and with bags."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_hand_ros.cli.output import NamespaceOption
from tactile_hand_ros.errors import TactileHandError, counted

if TYPE_CHECKING:
    from tactile_hand_ros.nodes.replay.options import ReplayOptions, ReplayProgress
    from tactile_hand_ros.nodes.replay.replay import Replay
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify.recompute import Comparison

EXIT_DIFFERS = 1

BagArgument = Annotated[Path, typer.Argument(help="Folder of a run, or a bag folder or file.")]


def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to create; by default beside the bag.")
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help="Repair the folder itself; keeps broken files as *.broken"),
    ] = False,
) -> None:
    """Repair a bag that was cut off, from any recorder."""
    from tactile_hand_ros.bag import recover as r

    if in_place and out is not None:
        raise TactileHandError("--in-place and --out were given, expected one of them.")
    found = r.find_bag(bag)
    if out is None and r.is_whole(found):
        print(f"{found} is whole, there is nothing to recover")
        return
    print(r.recover(found, out, in_place=in_place).sentence)


def replay(
    bag: BagArgument = Path("runs/latest"),
    rate: Annotated[float, typer.Option(help="Times the original speed.")] = 1.0,
    start_offset: Annotated[
        float, typer.Option(min=0.0, help="Where to begin [s after the first message].")
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    topics: Annotated[
        list[str] | None,
        typer.Option(help="Only topics whose whole name matches; may be repeated."),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(help="Not the topics whose whole name matches; may be repeated."),
    ] = None,
    clock: Annotated[
        bool, typer.Option("--clock", help="Publish the bag's time on /clock, 100 times a second.")
    ] = False,
    namespace: Annotated[str, typer.Option(help="Put before the names, as /left.")] = "",
    paused: Annotated[bool, typer.Option("--start-paused", help="Begin paused.")] = False,
    delay: Annotated[float, typer.Option(min=0.0, help="Wait before the first message [s].")] = 0.0,
    recompute: Annotated[
        bool,
        typer.Option("--recompute", help="Publish nothing: ask the controllers again, compare."),
    ] = False,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="With --recompute: another value, law.name=contact."
        ),
    ] = None,
    law: Annotated[
        str,
        typer.Option(
            metavar="MODULE:CLASS",
            help="With --recompute: a law of your own, here or on PYTHONPATH.",
        ),
    ] = "",
    nodes: Annotated[
        bool, typer.Option("--nodes", help="With --recompute: replay through the real nodes.")
    ] = False,
) -> None:
    """Publish a bag as it was recorded, or recompute it. Space pauses, Ctrl-C ends.

    Exit code of --recompute with the recorded law and without --set: 0 if all is as recorded, to
    the bit, 1 if not. A law of your own is imported only if you name it here, by --law.
    """
    if recompute:
        _recompute(bag, changes or [], law, namespace, nodes=nodes)
        return
    if changes or law or nodes:
        raise TactileHandError("--set, --law or --nodes was given, expected --recompute too.")
    from tactile_hand_ros.bag.recover import find_bag
    from tactile_hand_ros.nodes.replay.options import ReplayOptions

    if not 0.0 < rate < float("inf"):
        raise TactileHandError(f"--rate is {rate}, expected a number above 0.")
    options = ReplayOptions(
        rate=rate,
        start_offset=start_offset,
        loop=loop,
        topics=topics or [".*"],
        exclude=exclude or [],
        clock=100.0 if clock else 0.0,
        namespace="/" + namespace.strip("/") if namespace.strip("/") else "",
        paused=paused,
        delay=delay,
    )
    _publish(find_bag(bag), options)


def _recompute(bag: Path, changes: list[str], law: str, namespace: str, *, nodes: bool) -> None:
    from tactile_hand_ros.config.model import parse_changes
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify import recompute as r

    run = Run(bag, namespace=namespace or None)
    values = parse_changes(changes, "law.name=contact")
    is_as_recorded = not values
    if law:
        values["law.name"] = law
        recorded = r.scenario_of(run).manipulation_controller.law.name
        is_as_recorded = is_as_recorded and law == recorded
    if nodes:
        comparisons = _replay_through_nodes(run, values)
        _print("recorded and answered by the nodes", r.COLUMNS, r.rows(comparisons))
    else:
        result = r.recompute(run, values)
        comparisons = result.comparisons
        _print("recorded and recomputed", r.COLUMNS, r.rows(comparisons))
        speed = f"{result.speed:.1f} times real time"
        print(f"{result.simulated:g} s in {result.seconds:.2f} s, {speed}")
    if not is_as_recorded or all(comparison.same for comparison in comparisons):
        return
    print("The same configuration gave other answers" + r.reason(run), file=sys.stderr)
    raise typer.Exit(EXIT_DIFFERS)


def _replay_through_nodes(run: Run, values: dict[str, Any]) -> list[Comparison]:
    try:
        from tactile_hand_ros.verify.replay_through_nodes import replay_through_nodes
    except ModuleNotFoundError as error:
        raise TactileHandError(
            f"The nodes need ROS, but there is no module '{error.name}'; source ROS 2 or leave "
            "--nodes away."
        ) from None
    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("replaying through the nodes", total=1.0)
        return replay_through_nodes(run, values, lambda share: bar.update(task, completed=share))


def audit(bag: BagArgument = Path("runs/latest"), namespace: NamespaceOption = None) -> None:
    """Check every recorded f* against (13) and every torque against the law, independently.

    Exit code 0 if all agree, 1 if not.
    """
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify import audit as a
    from tactile_hand_ros.verify.recompute import reason

    run = Run(bag, namespace=namespace)
    checks = a.audit(run)
    _print("audit", a.COLUMNS, a.rows(checks))
    wrong = [check for check in checks if not check.ok]
    for check in wrong:
        print(
            f"{check.name}: wrong at {check.wrong} of {check.ticks} ticks, first at tick "
            f"{check.first} ns",
            file=sys.stderr,
        )
    if wrong:
        print("Not all agrees with the configuration" + reason(run), file=sys.stderr)
        raise typer.Exit(EXIT_DIFFERS)


def _print(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console

    from tactile_hand_ros.report.tables import rich_table

    console = Console()
    if not console.is_terminal:
        console.width = 140
    console.print(rich_table(title, columns, rows))


def _publish(bag: Path, options: ReplayOptions) -> None:
    try:
        from tactile_hand_ros.nodes.replay.node import replaying
    except ModuleNotFoundError as error:
        raise TactileHandError(
            f"Replay publishes in ROS, but there is no module '{error.name}'; source ROS 2 or "
            "install its wheels."
        ) from None

    with replaying(bag, options) as player, _line(player) as watch, _keyboard(player):
        for topic, reason in player.skipped.items():
            print(f"{topic} is not published: {reason}", file=sys.stderr)
        print(f"publishing {len(player.topics)} topics of {bag}", file=sys.stderr)
        try:
            player.run(watch)
        finally:
            print(f"published {counted(player.progress.messages, 'message')}", file=sys.stderr)


@contextlib.contextmanager
def _line(player: Replay) -> Iterator[Any]:
    """Show on a terminal where the replay is."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    text = TextColumn("{task.completed:.1f} of {task.total:.1f} s, {task.fields[state]}")
    bar = Bar(BarColumn(), text, console=console, transient=True, disable=not console.is_terminal)
    task = bar.add_task("replay", total=player.progress.duration, state="")

    def watch(progress: ReplayProgress) -> None:
        state = (
            "paused, space goes on" if progress.paused else counted(progress.messages, "message")
        )
        bar.update(task, completed=progress.position, state=state)

    with bar:
        yield watch


@contextlib.contextmanager
def _keyboard(player: Replay) -> Iterator[None]:
    """Let the space key pause, where there is a terminal."""
    if not sys.stdin.isatty():
        yield
        return
    import select
    import termios
    import threading
    import tty

    before = termios.tcgetattr(sys.stdin)
    done = threading.Event()

    def listen() -> None:
        while not done.is_set():
            if select.select([sys.stdin], [], [], 0.1)[0] and sys.stdin.read(1) == " ":
                player.toggle()

    thread = threading.Thread(target=listen, daemon=True)
    try:
        tty.setcbreak(sys.stdin)
        thread.start()
        yield
    finally:
        done.set()
        thread.join()
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


COMMANDS = (recover, replay, audit)
