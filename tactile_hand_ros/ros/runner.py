# SPDX-License-Identifier: Apache-2.0
"""The life of a process with nodes: start, spin, stop, exit code."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.exceptions import InvalidHandle, NotInitializedException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from tactile_hand_ros.config.paths import use_own_prefix
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.executor import spin
from tactile_hand_ros.ros.middleware import arguments_checked, use_sockets
from tactile_hand_ros.ros.scheduling import PRIORITY, parse_priority, raise_priority

EXIT_OK, EXIT_FAILED, EXIT_REFUSED = 0, 1, 2


def run_node(node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or shutdown; see `run_nodes`."""
    return run_nodes(lambda: [node()], args, described=[node])


def run_nodes(
    make: Callable[[], Iterable[Node]],
    args: Sequence[str] | None = None,
    *,
    described: Sequence[Callable[..., Any]] = (),
) -> int:
    """Run nodes together in this process until SIGINT, SIGTERM or shutdown.

    Before a node is destroyed its ``close()`` is called, if it has one.

    Args:
        make: Creates the nodes, one after the other.
        args: Command line with program name, by default ``sys.argv``.
        described: Objects whose docstrings ``--help`` prints.

    Returns:
        0 after a normal stop, 1 if a node failed while running, 2 if the configuration was
        rejected. The reason is printed to stderr.
    """
    line = list(sys.argv if args is None else args)
    _let_signals_shut_down()
    nodes: list[Node] = []
    try:
        priority = _init(line, described)
        for node in make():
            nodes.append(node)
        if not _was_signalled:
            for node in nodes:
                node.get_logger().info("ready")
    except BaseException as error:  # after any failure, destroy the nodes created so far
        return _stop(nodes, _code_of(error, EXIT_REFUSED))
    return _stop(nodes, _serve(nodes, priority))


def _serve(nodes: Sequence[Node], priority: int) -> int:
    gc.freeze()  # existing objects live as long as the process
    gc.enable()
    try:
        raise_priority(priority)
        spin(nodes)
    except BaseException as error:
        return _code_of(error, EXIT_FAILED)
    return EXIT_OK


def _code_of(error: BaseException, code: int) -> int:
    """Return the exit code for an error, and print the error for the user."""
    if isinstance(error, KeyboardInterrupt):
        return EXIT_OK
    if isinstance(error, TactileHandError):
        print(error, file=sys.stderr, flush=True)
        return code
    if isinstance(error, SystemExit) and isinstance(error.code, int):
        return error.code
    # It is no failure if a signal shut down the context during a callback.
    if isinstance(error, _WITHOUT_CONTEXT) and _was_signalled:
        return EXIT_OK
    sys.excepthook(type(error), error, error.__traceback__)
    return EXIT_FAILED


_WITHOUT_CONTEXT = (RuntimeError, InvalidHandle, NotInitializedException)
"""Exceptions of rclpy without a valid context; errors of rcl are RuntimeErrors."""

_was_signalled = False


def _let_signals_shut_down() -> None:
    """Make the first signal only shut down the context, so that no callback is interrupted."""
    global _was_signalled
    _was_signalled = False
    signal.signal(signal.SIGINT, _note_signal)
    signal.signal(signal.SIGTERM, _note_signal)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # ignored under nohup
        # A closed terminal stops the nodes as SIGTERM does, which rclpy handles.
        signal.signal(signal.SIGHUP, lambda *_: os.kill(os.getpid(), signal.SIGTERM))


def _ignore_signals() -> None:
    """Ignore signals while closing; a dying parent sends one for each of its threads."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def _note_signal(number: int, frame: FrameType | None) -> None:
    """Let rclpy shut down; a second signal interrupts code that does not return."""
    global _was_signalled
    if _was_signalled:
        _ignore_signals()
        raise KeyboardInterrupt
    _was_signalled = True


def _init(line: list[str], described: Sequence[Callable[..., Any]]) -> int:
    """Initialize rclpy and return the requested priority.

    Raises:
        ConfigurationError: If the ROS arguments, a parameter file or the priority is invalid.
        SystemExit: After ``--help``, or for an unknown argument.
    """
    parser = argparse.ArgumentParser(
        usage="%(prog)s [-h] [--priority N] [--ros-args -p name:=value --params-file FILE ...]",
        description="\n\n".join([(each.__doc__ or "").strip() for each in described]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    how = "run under SCHED_FIFO, 1 to 99"
    parser.add_argument(PRIORITY, type=parse_priority, default=0, metavar="N", help=how)
    use_sockets()
    use_own_prefix()  # without it, no type of message is found
    with arguments_checked():
        options = parser.parse_args(remove_ros_args(args=line)[1:])
        rclpy.init(args=line)
    if _was_signalled:  # before rclpy handles signals
        raise KeyboardInterrupt
    return int(options.priority)


def _stop(nodes: Sequence[Node], code: int) -> int:
    """Close and destroy the nodes, shut rclpy down and return the exit code."""
    _ignore_signals()
    for node in reversed(nodes):
        try:
            if hasattr(node, "close"):
                node.close()
        except Exception as error:
            code = max(code, _code_of(error, EXIT_FAILED))
    # Fast DDS can spin here for a long time while other processes leave (its issue 6513). All is
    # closed, so SIGTERM may end that.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for node in reversed(nodes):
        node.destroy_node()
    rclpy.try_shutdown()
    return code
