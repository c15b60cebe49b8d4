# SPDX-License-Identifier: Apache-2.0
"""How a process of nodes ends: its exit code, what it says, and in which order it closes."""

from __future__ import annotations

import signal
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.ros import runner

LOOSE = TactileHandError("the cable is loose, fix it.")


@pytest.fixture(autouse=True)
def _without_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_was_signalled", False)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 0, ""),
        (ExternalShutdownException(), 0, ""),
        (LOOSE, 7, "the cable is loose, fix it.\n"),
        (SystemExit(5), 5, ""),
        (SystemExit(0), 0, ""),
        (SystemExit("text"), 1, "SystemExit: text\n"),
        (ZeroDivisionError("0"), 1, "ZeroDivisionError: 0\n"),
        (InvalidHandle("gone"), 1, "InvalidHandle: gone\n"),
    ],
)
def test_an_exit_code_follows_from_the_error(
    error: BaseException, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert runner._code_of(error, 7) == code
    written = capsys.readouterr().err
    assert written.endswith(said) if said else written == ""


def test_after_a_signal_a_context_that_is_gone_is_no_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "_was_signalled", True)
    assert runner._code_of(InvalidHandle("gone"), 7) == 0
    assert capsys.readouterr().err == ""
    assert runner._code_of(ZeroDivisionError(), 7) == 1


def test_the_first_signal_is_noted_and_the_second_interrupts() -> None:
    runner._note_signal(signal.SIGINT, None)
    assert runner._was_signalled
    with pytest.raises(KeyboardInterrupt):
        runner._note_signal(signal.SIGINT, None)


@pytest.mark.parametrize("ignored", [True, False])
def test_a_closed_terminal_ends_nodes_unless_it_is_to_be_ignored(
    monkeypatch: pytest.MonkeyPatch, ignored: bool
) -> None:
    handlers: dict[int, Any] = {}
    before = signal.SIG_IGN if ignored else signal.SIG_DFL
    kernel = SimpleNamespace(
        SIGINT=signal.SIGINT,
        SIGTERM=signal.SIGTERM,
        SIGHUP=signal.SIGHUP,
        SIG_IGN=signal.SIG_IGN,
        signal=handlers.__setitem__,
        getsignal=lambda _: before,
    )
    monkeypatch.setattr(runner, "signal", kernel)
    monkeypatch.setattr(runner, "_was_signalled", True)
    runner._let_signals_shut_down()
    expected = {signal.SIGINT: runner._note_signal, signal.SIGTERM: runner._note_signal}
    assert handlers == expected | ({} if ignored else {signal.SIGHUP: runner._terminate})
    assert not runner._was_signalled
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr(
        runner, "os", SimpleNamespace(getpid=lambda: 42, kill=lambda *a: sent.append(a))
    )
    runner._terminate(signal.SIGHUP, None)
    assert sent == [(42, signal.SIGTERM)]


class ExampleConfig(Config):
    """A hand, a rate and more."""

    hand: str = param("paper", "hand")
    rate: float = param(0.0, "rate")
    gain: float = param(2.0, "gain")


class Example:
    """Does this and that."""

    def __init__(self, ended: list[str], name: str, error: Exception | None = None) -> None:
        self._ended, self._name, self._error = ended, name, error
        self.config: Any = ExampleConfig()
        self.context = SimpleNamespace(ok=lambda: True)

    def close(self) -> None:
        self._ended.append(f"close {self._name}")
        if self._error is not None:
            raise self._error

    def destroy_node(self) -> None:
        self._ended.append(f"destroy {self._name}")

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self._ended.append)


@pytest.mark.parametrize(
    ("error", "code", "expected", "said"),
    [
        (None, 0, 0, ""),
        (None, 2, 2, ""),
        (LOOSE, 0, 1, "the cable is loose, fix it.\n"),
        (LOOSE, 2, 2, "the cable is loose, fix it.\n"),
        (KeyError("x"), 0, 1, "KeyError: 'x'\n"),
    ],
)
def test_nodes_are_closed_in_reverse_whatever_happens(
    error: Exception | None,
    code: int,
    expected: int,
    said: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    ended: list[str] = []
    nodes: list[Any] = [Example(ended, "a"), Example(ended, "b", error)]
    assert runner._stop(nodes, code) == expected
    assert ended == ["close b", "destroy b", "close a", "destroy a"]
    assert capsys.readouterr().err.endswith(said)


def test_a_node_says_once_that_it_is_ready_and_with_what(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    node: Any = Example(said, "a")
    runner._announce(node)
    node.config = ExampleConfig(hand="", rate=250.0)
    runner._announce(node)
    node.config = None
    runner._announce(node)
    assert said == ["ready: hand paper", "ready: rate 250.0", "ready"]
    node.context = SimpleNamespace(ok=lambda: False)
    runner._announce(node)
    node.context = SimpleNamespace(ok=lambda: True)
    monkeypatch.setattr(runner, "_was_signalled", True)
    runner._announce(node)
    assert len(said) == 3


def test_help_has_the_words_of_each_node_and_how_to_pass_parameters() -> None:
    text = runner._help([Example, lambda: None])
    first, second, arguments, usage = text.split("\n\n")
    assert first == "Does this and that." and second == ""
    assert "--priority N" in arguments and "--params-file FILE" in usage


def test_what_exists_at_the_start_is_left_to_no_collector_and_then_it_spins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[Any] = []
    collector = SimpleNamespace(
        freeze=lambda: calls.append("freeze"), enable=lambda: calls.append("enable")
    )
    monkeypatch.setattr(runner, "gc", collector)
    monkeypatch.setattr(runner, "spin", calls.append)
    scheduling: Any = SimpleNamespace(raise_priority=lambda: calls.append("after"))
    node: Any = SimpleNamespace(context="context")
    assert runner._serve([node], scheduling) == 0
    assert calls == ["freeze", "enable", "after", [node]]

    def fail(_: Any) -> None:
        raise LOOSE

    monkeypatch.setattr(runner, "spin", fail)
    assert runner._serve([node], scheduling) == 1


class Middleware:
    """Stands in for rclpy and notes what it is asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.error: Exception | None = None
        monkeypatch.setattr(runner, "use_sockets", lambda: None)
        monkeypatch.setattr(runner, "rclpy", self)

    def init(self, args: list[str]) -> None:
        if self.error is not None:
            raise self.error


def test_a_signal_before_rclpy_can_know_of_it_ends_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Middleware(monkeypatch)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        for number in before:
            runner._let_signals_shut_down()
            signal.raise_signal(number)
            with pytest.raises(KeyboardInterrupt):
                runner._init(["program"], [Example])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        monkeypatch.setattr(runner, "_was_signalled", False)


def test_arguments_that_are_not_known_or_cannot_be_used_are_refused_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ros = Middleware(monkeypatch)
    with pytest.raises(ConfigurationError, match="unknown argument '--fast', expected --priority"):
        runner._init(["program", "--fast", "--slow"], [Example])
    for word in ("-h", "--help"):
        with pytest.raises(SystemExit) as ended:
            runner._init(["program", word], [Example])
        assert ended.value.code == 0
        assert capsys.readouterr().out.startswith("Does this and that.\n\nArguments: ")
    ros.error = RuntimeError("failed to initialize rcl: no such rule, at ./src/file.c:7")
    with pytest.raises(
        ConfigurationError, match=r"^the ROS arguments cannot be used: no such rule\.$"
    ):
        runner._init(["program"], [Example])


def test_a_process_makes_checks_and_serves_its_nodes_and_ends_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[Any] = []
    monkeypatch.setattr(runner, "_let_signals_shut_down", lambda: done.append("signals"))
    monkeypatch.setattr(runner, "_init", lambda line, _: done.append(line) or "scheduling")
    monkeypatch.setattr(runner, "_serve", lambda nodes, how: done.append((len(nodes), how)) or 1)
    monkeypatch.setattr(runner, "rclpy", SimpleNamespace(try_shutdown=lambda: done.append("end")))

    def named(name: str) -> Any:
        node: Any = Example(done, name)
        node.config = None
        node.check_ready = lambda: done.append(f"check {name}")
        return node

    def both() -> Any:
        yield named("a")
        yield named("b")

    ends = ["close b", "destroy b", "close a", "destroy a", "end"]
    assert runner.run_nodes(both, ["program"]) == 1
    start = ["signals", ["program"]]
    assert done == [*start, "check a", "ready", "check b", "ready", (2, "scheduling"), *ends]
    done.clear()
    monkeypatch.setattr(runner.sys, "argv", ["other"])

    def refuse() -> Any:
        yield named("a")
        raise LOOSE

    assert runner.run_nodes(refuse) == 2
    assert done == ["signals", ["other"], "close a", "destroy a", "end"]
    assert capsys.readouterr().err == "the cable is loose, fix it.\n"
    done.clear()
    assert runner.run_node(lambda: named("a"), ["x"]) == 1
