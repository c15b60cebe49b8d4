# SPDX-License-Identifier: Apache-2.0
"""Every command ends with one sentence and the code that belongs to it."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from tactile_hand_ros.command_line import LastingOutput, nearest, os_sentence, run_command, say
from tactile_hand_ros.errors import BagError


def failing(error: BaseException) -> Callable[[], Any]:
    def command() -> None:
        raise error

    return command


@pytest.mark.parametrize(("answer", "code"), [(None, 0), ("text", 0), (0, 0), (3, 3), (True, 1)])
def test_what_a_command_returns_is_its_code_if_it_is_a_number(answer: Any, code: int) -> None:
    assert run_command("program", lambda: answer) == code


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (BagError("no bag."), 2, "program: no bag.\n"),
        (OSError(errno.ENOENT, "Gone", "file"), 2, "program: 'file' cannot be used: Gone.\n"),
        (KeyboardInterrupt(), 130, "program: interrupted.\n"),
    ],
)
def test_an_error_is_one_sentence(
    error: BaseException, code: int, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command("program", failing(error)) == code
    assert capsys.readouterr() == ("", sentence)


def test_a_defect_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError):
        run_command("program", failing(ZeroDivisionError()))


@pytest.mark.parametrize("name", ["exit_code", "format_message"])
def test_what_only_looks_like_a_wrong_option_is_a_defect(name: str) -> None:
    error = RuntimeError("x")
    setattr(error, name, lambda: "text")
    with pytest.raises(RuntimeError):
        run_command("program", failing(error))


def test_an_input_that_ended_too_early_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    error = RuntimeError("x")
    error.__cause__ = EOFError()
    assert run_command("program", failing(error)) == 2
    assert "the input ended too early" in capsys.readouterr().err


class UsageError(Exception):
    """As Click raises it."""

    exit_code = 7

    def __init__(self, text: str, **more: Any) -> None:
        super().__init__(text)
        self.__dict__.update(more)

    def format_message(self) -> str:
        return str(self)


CONTEXT = SimpleNamespace(
    command_path="hand run",
    command=SimpleNamespace(params=[SimpleNamespace(opts=["name"]), SimpleNamespace(opts=["--x"])]),
)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (UsageError("Bad."), "program: Bad.\n"),
        (UsageError("Bad", ctx=CONTEXT), "program: Bad. See `hand run --help`.\n"),
        (UsageError("Did you?", ctx=None), "program: Did you?\n"),
        (UsageError(""), ""),
        (
            UsageError("x", possibilities=[], option_name="--y", ctx=CONTEXT),
            "program: there is no option --y, did you mean '--x'? See `hand run --help`.\n",
        ),
    ],
)
def test_a_wrong_option_has_the_code_of_its_error(
    error: Exception, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command("program", failing(error)) == 7
    assert capsys.readouterr().err == sentence


@pytest.mark.usefixtures("hangups_count")
@pytest.mark.parametrize(
    ("number", "usual", "sentence"),
    [
        (signal.SIGINT, signal.default_int_handler, "program: interrupted.\n"),
        (signal.SIGTERM, signal.SIG_DFL, "program: ended by SIGTERM.\n"),
        (signal.SIGHUP, signal.SIG_DFL, "program: ended by SIGHUP.\n"),
    ],
)
def test_a_signal_ends_a_command_in_order_while_it_runs_and_only_then(
    number: signal.Signals, usual: Any, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    was_ended = []

    def command() -> None:
        try:
            signal.raise_signal(number)
        finally:
            was_ended.append(True)

    before = signal.getsignal(number)
    signal.signal(number, usual)
    try:
        assert run_command("program", command) == 128 + number
        assert was_ended and capsys.readouterr().err == sentence
        assert signal.getsignal(number) is usual
        signal.signal(number, signal.SIG_IGN)
        assert run_command("program", lambda: signal.raise_signal(number)) == 0
        assert signal.getsignal(number) is signal.SIG_IGN
        signal.signal(number, usual)
        assert run_command("program", lambda: signal.signal(number, signal.SIG_IGN)) == 0
        assert signal.getsignal(number) is signal.SIG_IGN  # what the command has set stays
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(errno.ENOSPC, "Full", "a"), "'a' cannot be used: Full; free some space or write"),
        (OSError(errno.EACCES, "No"), "it cannot be read or written: No; check the permissions."),
        (OSError(errno.EROFS, "No"), "it cannot be read or written: No; write elsewhere."),
        (OSError("words"), "it cannot be read or written: words."),
        (TimeoutError(), "it cannot be read or written: TimeoutError."),
    ],
)
def test_what_the_system_refuses_is_explained(error: OSError, sentence: str) -> None:
    assert os_sentence(error).startswith(sentence) and os_sentence(error).endswith(".")


def test_the_nearest_name_is_offered() -> None:
    assert nearest("pape", ["gravity", "paper", "papers"]) == ", did you mean 'paper'?"
    assert nearest("xyz", ["gravity", "paper"]) == "."


def test_nothing_is_said_without_words(capsys: pytest.CaptureFixture[str]) -> None:
    say("program", "")
    assert capsys.readouterr().err == ""


def test_without_an_output_a_command_is_not_begun(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert run_command("program", failing(ZeroDivisionError())) == 2
    assert "the standard output is closed" in capsys.readouterr().err


class Full(io.StringIO):
    """An output that cannot be written, on a descriptor of its own."""

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


@pytest.mark.parametrize(
    ("error", "is_told"), [(OSError(errno.ENOSPC, "Full"), True), (BrokenPipeError(), False)]
)
def test_work_goes_on_when_nothing_can_be_written(
    error: OSError, is_told: bool, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stdout", Full(file, error))
        output = LastingOutput()
        assert output.write("four") == 4 and output.problem is (error if is_told else None)
        output.write("more")
        assert output.problem is (error if is_told else None)
        assert (output.encoding, output.isatty(), output.fileno()) == (
            "ascii",
            False,
            file.fileno(),
        )
        file.write("lost")  # what the descriptor leads to now
        file.flush()
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.parametrize(
    ("error", "code"), [(OSError(errno.ENOSPC, "Full"), 2), (BrokenPipeError(), 0)]
)
@pytest.mark.parametrize("is_refused", [False, True])
def test_output_that_cannot_be_written_is_dropped(
    error: OSError,
    code: int,
    is_refused: bool,
    tmp_path: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What is buffered is written at the end, and the interpreter must not try it again."""
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stdout", Full(file, error))
        command = failing(BagError("no bag.")) if is_refused else lambda: None
        assert run_command("program", command) == (2 if is_refused else code)
        file.write("lost")
        file.flush()
    assert (tmp_path / "file").read_text() == ""
    told = "no bag." if is_refused else "it cannot be read or written: Full" if code else ""
    assert told in capsys.readouterr().err


def test_a_reader_that_has_left_is_no_failure(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stdout", file)
        assert run_command("program", failing(BrokenPipeError())) == 0
        file.write("lost")
        file.flush()
    assert (tmp_path / "file").read_text() == ""


def test_what_is_buffered_may_be_what_cannot_be_written(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stdout", Full(file, OSError(errno.ENOSPC, "Full")))
        output = LastingOutput()
        output.flush()
        assert output.problem is not None
        file.write("lost")
        file.flush()
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_letters_that_the_terminal_lacks_are_written_as_escapes(
    name: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    with file.open("w", encoding="ascii") as stream:
        monkeypatch.setattr(sys, name, stream)
        assert run_command("program", lambda: print("é", file=getattr(sys, name)) or 3) == 3
    assert file.read_text() == "\\xe9\n"


def test_a_sentence_has_nowhere_to_go_without_a_terminal(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    say("program", "lost")
    with (tmp_path / "file").open("w") as file:
        monkeypatch.setattr(sys, "stderr", Full(file, OSError(errno.EIO, "gone")))
        say("program", "lost")
        file.write("lost")  # what the descriptor leads to now
        file.flush()
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.usefixtures("hangups_count")
def test_a_signal_gives_its_code_also_where_what_was_printed_cannot_be_written() -> None:
    """Python itself would end with 120."""
    program = """
import os, signal, sys
from tactile_hand_ros.command_line import run_command

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
