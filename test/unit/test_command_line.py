# SPDX-License-Identifier: Apache-2.0
"""Every command ends with one sentence and the matching exit code."""

import errno
import io
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any
from unittest.mock import Mock

import pytest

from tactile_hand_ros.command_line import Interrupted, Signals, run_command
from tactile_hand_ros.errors import BagError


def test_what_a_command_returns_is_its_code_if_it_is_a_number():
    codes = [run_command("program", lambda a=answer: a) for answer in (None, "text", 0, 3, True)]
    assert codes == [0, 0, 0, 3, 1]


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (BagError("no bag."), 2, "no bag."),
        (OSError(errno.ENOENT, "Gone", "file"), 2, "'file' cannot be used: Gone."),
        (OSError(errno.EROFS, "No"), 2, "it cannot be read or written: No."),
        (TimeoutError(), 2, "it cannot be read or written: TimeoutError."),
        (KeyboardInterrupt(), 130, "interrupted."),
    ],
)
def test_an_error_is_one_sentence(error, code, sentence, capsys):
    assert run_command("program", Mock(side_effect=error)) == code
    assert capsys.readouterr() == ("", f"program: {sentence}\n")


def test_a_defect_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        run_command("program", Mock(side_effect=ZeroDivisionError))


@pytest.mark.usefixtures("hangups_count")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_command_in_order_while_it_runs_and_only_then(number, capsys):
    usual, sentence = signal.SIG_DFL, f"ended by {number.name}."
    if number == signal.SIGINT:
        usual, sentence = signal.default_int_handler, "interrupted."
    was_ended = []

    def command() -> None:
        try:
            signal.raise_signal(number)
        finally:
            was_ended.append(True)

    signal.signal(number, usual)
    assert run_command("program", command) == 128 + number
    assert was_ended and capsys.readouterr().err == f"program: {sentence}\n"
    assert signal.getsignal(number) is usual
    signal.signal(number, signal.SIG_IGN)
    assert run_command("program", lambda: signal.raise_signal(number)) == 0
    assert signal.getsignal(number) is signal.SIG_IGN
    signal.signal(number, usual)
    assert run_command("program", lambda: signal.signal(number, signal.SIG_IGN)) == 0
    assert signal.getsignal(number) is signal.SIG_IGN  # the command's own setting stays


def test_an_error_of_what_a_signal_interrupted_is_the_interruption(handlers, capsys):
    def command() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            threading.Thread().join()  # fails, as in a library that was starting a thread

    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert run_command("program", command) == 130
    assert capsys.readouterr() == ("", "program: interrupted.\n")


def test_where_the_output_is_closed_it_is_dropped(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    assert run_command("program", lambda: print("text")) == 0


class Full(io.StringIO):
    """An output that cannot be written, with its own descriptor."""

    encoding = "ascii"  # type: ignore[assignment]

    def __init__(self, file: Any, error: OSError) -> None:
        super().__init__()
        self._file, self._error = file, error

    def fileno(self) -> int:
        return int(self._file.fileno())

    def write(self, text: str) -> int:
        raise self._error

    def flush(self) -> None:
        if not self.closed:
            raise self._error


def test_a_reader_that_is_gone_is_no_failure_but_any_other_exit_is(capsys):
    def exiting(cause: OSError) -> None:
        try:
            raise cause
        except OSError:
            sys.exit(1)  # as Typer and Rich do

    assert run_command("program", lambda: exiting(BrokenPipeError())) == 0
    assert capsys.readouterr().err == ""
    with pytest.raises(SystemExit):
        run_command("program", lambda: exiting(FileNotFoundError()))
    with pytest.raises(SystemExit):
        run_command("program", lambda: sys.exit(3))


@pytest.mark.parametrize(
    ("error", "code"), [(OSError(errno.ENOSPC, "Full"), 2), (BrokenPipeError(), 0)]
)
@pytest.mark.parametrize("is_refused", [False, True])
def test_output_that_cannot_be_written_is_dropped(
    error, code, is_refused, tmp_path, monkeypatch, capsys
):
    """The buffer is written at the end, and the interpreter must not try it again."""
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stdout", Full(file, error))
        command = Mock(side_effect=BagError("no bag.")) if is_refused else lambda: None
        assert run_command("program", command) == (2 if is_refused else code)
        file.write("lost")
        file.flush()
    assert (tmp_path / "file").read_text() == ""
    told = "no bag." if is_refused else "it cannot be read or written: Full" if code else ""
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_letters_that_the_terminal_lacks_are_written_as_escapes(name, tmp_path, monkeypatch):
    file = tmp_path / "file"
    with file.open("w", encoding="ascii") as stream:
        monkeypatch.setattr(sys, name, stream)
        assert run_command("program", lambda: print("é", file=getattr(sys, name)) or 3) == 3
    assert file.read_text() == "\\xe9\n"


@pytest.mark.usefixtures("hangups_count")
def test_a_signal_gives_its_code_also_where_what_was_printed_cannot_be_written():
    """Python itself would exit with 120."""
    program = """
import os, signal, sys
from tactile_hand_ros.command_line import Interrupted, Signals, run_command

def command():
    print("text")
    os.kill(os.getpid(), signal.SIGHUP)
    signal.pause()

sys.exit(run_command("program", command))
"""
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    with open("/dev/full", "w") as full:
        ended = subprocess.run(
            [sys.executable, "-c", program], stdout=full, stderr=-1, env=buffered, check=False
        )
    assert (ended.returncode, ended.stderr) == (129, b"program: ended by SIGHUP.\n")


FLOOD = """
import os, signal, threading
from tactile_hand_ros.command_line import Interrupted, Signals

signals, pause = Signals().install(), threading.Event()

def send():
    for _ in range(5000):
        os.kill(os.getpid(), signal.SIGINT)
        pause.wait(2e-5)

sender = threading.Thread(target=send)
sender.start()
woken = 0
while sender.is_alive():
    signals.number = 0
    try:
        signals.wait(1e-5)
    except Interrupted:
        woken += 1
print(woken)
"""


@pytest.fixture
def signals(hangups_count: None) -> Signals:
    return Signals().install()


def test_a_wait_without_a_signal_lasts_as_long_as_it_should(signals):
    for _ in range(2):
        start = time.monotonic()
        signals.wait(0.01)
        assert 0.01 <= time.monotonic() - start < 5.0
    signals.check()
    assert signals.number == 0


def test_a_wait_ends_with_the_signal_and_the_first_one_counts(signals):
    sender = threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGTERM))
    sender.start()
    with pytest.raises(Interrupted, match="ended by SIGTERM"):
        signals.wait(1000.0)
    sender.join()
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(3):  # repeatedly
        with pytest.raises(Interrupted, match="ended by SIGTERM"):
            signals.wait(1000.0)
    assert (signals.number, signals.exit_code) == (signal.SIGTERM, 143)


def test_a_hangup_that_is_ignored_stays_so(signals):
    """As for nohup; an ignored SIGINT is handled all the same, because it ends a run."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signals.install()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(Interrupted, match="SIGINT"):
        signals.check()


def test_signals_at_any_moment_of_a_wait_do_not_lock_it():
    """A handler may run between any two steps of the wait, so shared state must tolerate it."""
    assert int(subprocess.check_output([sys.executable, "-c", FLOOD], timeout=60.0)) > 0
