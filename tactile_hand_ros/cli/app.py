# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand`: each command imports what it needs, so that help is fast."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

try:
    import typer
except ModuleNotFoundError:  # the nodes run without it
    sys.exit(
        "tactile-hand needs the Python libraries typer and rich; run `pip install typer rich`."
    )

from tactile_hand_ros.cli import experiments, runs, steer
from tactile_hand_ros.command_line import prepare_for_ros, run_command
from tactile_hand_ros.config.paths import use_own_prefix
from tactile_hand_ros.orchestrator import command as orchestrator

PROGRAM = "tactile-hand"

app = typer.Typer(
    name=PROGRAM,
    help="Hold and turn an unknown object with a tactile prosthetic hand.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # it would read units such as [s] as markup and drop them
)

for _command in (
    orchestrator.run,
    *steer.COMMANDS,
    *experiments.COMMANDS,
    *runs.COMMANDS,
):
    app.command()(_command)
# An unknown option may be a negative number.
app.command(context_settings={"ignore_unknown_options": True})(steer.move)
app.command(context_settings={"ignore_unknown_options": True})(steer.squeeze)


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
    """Hold and turn an unknown object with a tactile prosthetic hand."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Args:
        arguments: Command line without the program's name; None takes ``sys.argv``.

    Returns:
        0 after success, 2 when something was refused (one sentence on stderr), 130 after Ctrl-C.
    """
    prepare_for_ros()
    use_own_prefix()
    # Stay on this machine by default.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = list(sys.argv[1:] if arguments is None else arguments)
    return run_command(PROGRAM, lambda: app(args=words, prog_name=PROGRAM, standalone_mode=False))
