# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand`: everything offline. Each command imports what it needs, so that help is fast."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any, cast

try:
    import typer
except ModuleNotFoundError:  # the nodes run without it
    sys.exit(
        "tactile-hand needs the Python libraries typer and rich; run `pip install typer rich`."
    )

from tactile_hand_ros.cli import bags, bench, measure, runs, scenarios
from tactile_hand_ros.errors import TactileHandError

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

for _command in (
    measure.reproduce,
    *runs.COMMANDS,
    *scenarios.COMMANDS,
    bench.bench,
    *bags.COMMANDS,
):
    app.command()(_command)
app.add_typer(study_app, name="study", no_args_is_help=True)
study_app.command()(measure.slip)


@study_app.callback()
def study() -> None:
    """Many runs on all cores, ending in figures and a table."""


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
