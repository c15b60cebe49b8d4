# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand`: each command imports only its own dependencies, so that help is fast."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated

try:
    import typer
except ModuleNotFoundError:  # the nodes run without it
    sys.exit(
        "tactile-hand needs the Python libraries typer and rich; run `pip install typer rich`."
    )

from tactile_hand_ros.cli import experiments, live, runs, steer
from tactile_hand_ros.command_line import prepare_for_ros, run_command
from tactile_hand_ros.config.paths import use_own_prefix
from tactile_hand_ros.orchestrator import command as orchestrator

PROGRAM = "tactile-hand"

EXAMPLES = {
    "run": "run human_pull --set slip_regulator.mode=user --duration 5",
    "live": "live human_hold --set plant.rate=500",
    "grasp": "grasp my/my_hand.yaml 0.06",
    "release": "release --namespace /left",
    "show": "show human_pull",
    "hand": "hand my/my_hand.yaml",
    "sweep": 'sweep paper --over "calibration.link_lengths=0.9..1.1"',
    "reproduce": "reproduce --layout pinch",
    "report": "report runs/latest --out .",
    "replay": "replay runs/latest --rate 2 --topics /joint_states",
    "move": "move 0.0 0.0436 0.4118 --rotation 0 0 -3",
    "squeeze": "squeeze 12",
}

app = typer.Typer(
    name=PROGRAM,
    help="Tactile in-hand manipulation: run, steer, record and study a hand.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich would drop units such as [s] as markup
)


def _example(command: Callable[..., None]) -> str | None:
    """Return the text below the help of a command."""
    example = EXAMPLES.get(command.__name__)
    return example and f"Example: {PROGRAM} {example}"


for _command in (
    orchestrator.run,
    *live.COMMANDS,
    *steer.COMMANDS,
    *experiments.COMMANDS,
    *runs.COMMANDS,
):
    # An unknown option may be a negative number.
    _settings = {"ignore_unknown_options": _command in (steer.move, steer.squeeze)}
    app.command(epilog=_example(_command), context_settings=_settings)(_command)


def _print_version(wanted: bool) -> None:
    if wanted:
        from tactile_hand_ros.bag.provenance import versions

        print(f"{PROGRAM} {versions()['tactile_hand_ros']}")
        raise typer.Exit


@app.callback()
def tactile_hand(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Tactile in-hand manipulation: run, steer, record and study a hand."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; `arguments` lacks the program's name."""
    prepare_for_ros()
    use_own_prefix()
    # Stay on this machine by default.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = list(sys.argv[1:] if arguments is None else arguments)
    return run_command(PROGRAM, lambda: app(args=words, prog_name=PROGRAM, standalone_mode=False))
