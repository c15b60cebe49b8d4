# SPDX-License-Identifier: Apache-2.0
"""The command line of the orchestrator and of `tactile-hand run`; `execute` loads the rest."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import typer

from tactile_hand_ros.command_line import Interrupted, Signals, prepare_for_ros, run_command, say
from tactile_hand_ros.orchestrator.options import RunOptions, with_options

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
@with_options
def run(context: typer.Context, options: RunOptions) -> None:
    """Run a scenario and judge whether its goal is reached.

    Starts the nodes, commands the targets, records a bag and writes a report.

    Exit code 0: the goal was reached and the bag is complete; 1: it was not, or something failed;
    2: the scenario was refused and nothing was started; 3: the object was dropped; 130, 143: ended
    by SIGINT, SIGTERM. Without a recording nothing is judged: 0 means that nothing failed.
    """
    signals, ros_arguments = context.obj or (Signals().install(), [])
    raise typer.Exit(start(options, signals, ros_arguments, str(context.find_root().info_name)))


def start(
    options: RunOptions,
    signals: Signals,
    ros_arguments: Sequence[str],
    program: str,
    companion: Callable[..., AbstractContextManager[None]] | None = None,
) -> int:
    """Load the orchestrator, run a scenario and return the exit code; see `execute.execute`."""
    from tactile_hand_ros.compiled import run_interpreted
    from tactile_hand_ros.ros.middleware import check_environment

    check_environment(os.environ)
    run_interpreted()  # the check is too short to justify loading Numba
    # Loading takes half a second; a Ctrl-C during that time must not interrupt an import.
    from tactile_hand_ros.orchestrator.execute import execute

    try:
        return execute(options, signals, ros_arguments, companion)
    except Interrupted as interruption:
        say(program, f"{interruption}, before anything was started.")
        return signals.exit_code


def main(args: Sequence[str] | None = None) -> int:
    """Run the orchestrator and return its exit code; `args` includes the program name."""
    prepare_for_ros()
    signals = Signals().install()
    line = list(sys.argv if args is None else args)

    def command() -> object:
        own, ros_arguments = split_ros_arguments(line)
        given = (signals, ros_arguments)
        return app(args=own, prog_name="orchestrator", standalone_mode=False, obj=given)

    return run_command("orchestrator", command)


def split_ros_arguments(line: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line with program name into our arguments and a line for rclpy.

    Raises:
        ConfigurationError: If the ROS arguments are malformed.
    """
    if "--ros-args" not in line:
        return list(line)[1:], []
    from rclpy.utilities import remove_ros_args

    from tactile_hand_ros.ros.middleware import arguments_checked

    with arguments_checked():
        return remove_ros_args(list(line))[1:], list(line)
