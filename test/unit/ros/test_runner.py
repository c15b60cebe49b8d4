# SPDX-License-Identifier: Apache-2.0
"""How a process of nodes stops: exit code, output, and order of closing."""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from ament_index_python.packages import get_package_share_path
from rclpy.node import Node

from bench.processes import CapturedProcess
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.nodes.force_optimizer import ForceOptimizerNode
from tactile_hand_ros.ros import runner

LOOSE = TactileHandError("the cable is loose, fix it.")


@pytest.fixture(autouse=True)
def _process(handlers: None, domain: int) -> Iterator[None]:
    """Restore the signal handlers and the garbage collector."""
    yield
    gc.unfreeze()


class Example(Node):
    """Does this and that."""

    def __init__(self, action: Callable[[], Any], name: str = "a", closing: Any = None) -> None:
        super().__init__(name)
        self._closing = closing
        self.create_timer(0.01, action)

    def close(self) -> None:
        print(f"close {self.get_name()}")
        if self._closing is not None:
            raise self._closing


def fail(error: BaseException) -> Callable[[], None]:
    def action() -> None:
        raise error

    return action


def send(*numbers: int) -> Callable[[], None]:
    def action() -> None:
        for number in numbers:
            os.kill(os.getpid(), number)
        assert len(numbers) < 2  # the second one interrupts

    return action


@pytest.mark.parametrize(
    ("action", "code", "printed"),
    [
        (rclpy.shutdown, 0, ""),
        (send(signal.SIGINT), 0, ""),
        (send(signal.SIGTERM), 0, ""),
        (send(signal.SIGHUP), 0, ""),
        (send(signal.SIGTERM, signal.SIGTERM), 0, ""),
        (fail(KeyboardInterrupt()), 0, ""),
        (fail(LOOSE), 1, "the cable is loose, fix it.\n"),
        (fail(SystemExit(5)), 5, ""),
        (fail(SystemExit("text")), 1, "SystemExit: text\n"),
        (fail(ZeroDivisionError("0")), 1, "ZeroDivisionError: 0\n"),
    ],
)
@pytest.mark.usefixtures("hangups_count")
def test_the_exit_code_follows_from_what_stops_the_nodes(action, code, printed, capfd):
    assert runner.run_node(lambda: Example(action), ["program"]) == code
    captured = capfd.readouterr()
    assert captured.out == "close a\n"
    ready, _, rest = captured.err.partition("[a]: ready\n")
    assert ready.startswith("[INFO]") and rest.endswith(printed) and bool(rest) == bool(printed)
    assert not rclpy.ok()


def test_a_node_that_runs_collects_garbage_but_not_among_what_was_loaded():
    """The executables switch the collector off while they load."""
    seen: list[tuple[bool, bool]] = []

    def look() -> None:
        seen.append((gc.isenabled(), gc.get_freeze_count() > 0))
        rclpy.shutdown()

    gc.disable()
    assert runner.run_node(lambda: Example(look), ["program"]) == 0
    assert seen == [(True, True)]


def test_without_a_sourced_workspace_the_types_of_messages_are_found(monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert runner.run_node(lambda: Example(rclpy.shutdown), ["program"]) == 0
    assert get_package_share_path("std_msgs").is_dir()


def test_a_closed_terminal_does_not_stop_nodes_that_ignore_it(capfd):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    actions = iter([send(signal.SIGHUP), rclpy.shutdown])
    done: list[int] = []

    def act() -> None:
        next(actions)()
        done.append(1)

    assert runner.run_node(lambda: Example(act), ["program"]) == 0
    assert len(done) == 2


@pytest.mark.parametrize(
    ("closing", "code", "printed"),
    [(None, 0, ""), (LOOSE, 1, "the cable is loose"), (KeyError("x"), 1, "KeyError: 'x'")],
)
def test_nodes_are_closed_in_reverse_whatever_happens(closing, code, printed, capfd):
    def both() -> Iterator[Node]:
        yield Example(rclpy.shutdown, "a")
        yield Example(rclpy.shutdown, "b", closing)

    assert runner.run_nodes(both, ["program"]) == code
    captured = capfd.readouterr()
    assert captured.out == "close b\nclose a\n" and printed in captured.err


HANGING = """
import signal, sys, threading
from rclpy.node import Node
from tactile_hand_ros.ros.runner import run_node

class Hanging(Node):
    def close(self):
        signal.raise_signal(signal.SIGTERM)  # must not interrupt this
        print("closed", flush=True)

    def destroy_node(self):
        print("hanging", flush=True)
        threading.Event().wait()

sys.exit(run_node(lambda: Hanging("a"), ["program"]))
"""


def test_a_node_that_has_closed_and_cannot_be_destroyed_ends_at_sigterm():
    with CapturedProcess([sys.executable, "-c", HANGING]) as process:
        process.wait_for_output("ready")
        process.send(signal.SIGINT)
        process.wait_for_output("closed\nhanging\n")
        process.send(signal.SIGTERM)
        assert process.wait() == -signal.SIGTERM


def test_a_node_that_cannot_be_made_closes_those_before_it(capfd):
    def both() -> Iterator[Node]:
        yield Example(rclpy.shutdown)
        raise LOOSE

    assert runner.run_nodes(both, ["program"]) == 2
    captured = capfd.readouterr()
    assert captured.out == "close a\n" and captured.err == "the cable is loose, fix it.\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_before_rclpy_handles_it_stops_the_process(monkeypatch, number):
    monkeypatch.setattr(runner, "use_sockets", lambda: signal.raise_signal(number))
    assert runner.run_node(lambda: pytest.fail("no node is made"), ["program"]) == 0


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        (["--help"], 0, "--params-file FILE ...]\n\nDoes this and that.\n"),
        (["--fast"], 2, "--priority N] [--ros-args"),
        (["--fast"], 2, "error: unrecognized arguments: --fast"),
        (["--priority", "100"], 2, "--priority is '100', expected a whole number from 1 to 99"),
        (["--priority=-1"], 2, "--priority is '-1', expected a whole number from 1 to 99"),
        (["--ros-args", "-r", "x"], 2, "the ROS arguments cannot be used: "),
    ],
)
def test_arguments_are_explained_or_rejected_in_a_sentence(words, code, printed, capfd):
    assert runner.run_node(Example, ["program", *words]) == code
    captured = capfd.readouterr()
    assert printed in (captured.err if code else captured.out)
    assert "src/" not in captured.err


def test_a_wrong_parameter_ends_the_start_with_a_sentence(capfd, monkeypatch):
    words = "unknown parameter 'minimum_norma', did you mean 'minimum_normal'"
    argv = ["program", "--ros-args", "-p", "minimum_norma:=1.0"]
    monkeypatch.setattr("sys.argv", argv)
    assert runner.run_node(ForceOptimizerNode, argv) == 2
    printed = capfd.readouterr().err
    assert words in printed and "Traceback" not in printed
