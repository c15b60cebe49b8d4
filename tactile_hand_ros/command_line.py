# SPDX-License-Identifier: Apache-2.0
"""Common behavior of all command lines: one sentence per error, and its exit code."""

from __future__ import annotations

import contextlib
import os
import queue
import re
import signal
import sys
import webbrowser
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from tactile_hand_ros.errors import TactileHandError

EXIT_REFUSED = 2
_ENDS: dict[signal.Signals, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
"""Signals that end a command, and their default handlers."""


def run_command(program: str, command: Callable[[], Any]) -> int:
    """Run a command, which returns an exit code or anything else for success; return the code.

    It is 0 after success; 2, with one sentence on stderr, if the input was rejected or could not be
    read or written; 128 plus the number of a signal that ended it, such as 130 after Ctrl-C.
    """
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # print what the terminal cannot encode as escapes
            stream.reconfigure(errors="backslashreplace")
    try:
        with _ended_by_signals():
            code = command()
            sys.stdout.flush()
    except BaseException as error:
        sentence, code = _explained(error)
        if code is None:
            raise
        with _dropped(sys.stdout):  # the terminal or the reader may be gone
            sys.stdout.flush()
        say(program, sentence)
    return code if isinstance(code, int) else 0


class _Signalled(BaseException):
    """Raised by a signal: Typer would turn a KeyboardInterrupt into a silent exit code."""


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let signals without another handler raise `_Signalled`.

    A command can then clean up: processes, progress bars, unfinished files.
    """
    mine = [number for number, usual in _ENDS.items() if signal.getsignal(number) is usual]
    for number in mine:
        signal.signal(number, _raise)
    try:
        yield
    finally:
        for number in mine:
            if signal.getsignal(number) is _raise:
                signal.signal(number, _ENDS[number])


def _raise(number: int, frame: FrameType | None) -> None:
    raise _Signalled(signal.Signals(number))


class Interrupted(Exception):
    """The user or the system ended the command."""


class Signals:
    """Stores the first SIGINT, SIGTERM or SIGHUP, and wakes up the waiting thread."""

    def __init__(self) -> None:
        """Start without a signal."""
        self.number = 0
        # A handler may interrupt `get` with `put` in the same thread. The `set` of an Event would
        # deadlock on the lock that the interrupted `wait` holds.
        self._came: queue.SimpleQueue[int] = queue.SimpleQueue()

    def install(self) -> Signals:
        """Install the handlers and return self; an ignored SIGHUP stays ignored, as for ``nohup``.

        Shells without job control start background jobs with SIGINT ignored. Like rclpy, this
        handles it all the same, because SIGINT ends a run.
        """
        for number in _ENDS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._note)
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.number = self.number or number
        self._came.put(number)

    @property
    def exit_code(self) -> int:
        """The code that a shell expects after the first signal."""
        return 128 + self.number

    def check(self) -> None:
        """Raise `Interrupted` if a signal has arrived."""
        if self.number:
            raise Interrupted(f"ended by {signal.Signals(self.number).name}")

    def wait(self, seconds: float) -> None:
        """Wait for some seconds; raise Interrupted after a signal."""
        self.check()
        with contextlib.suppress(queue.Empty):
            self._came.get(timeout=seconds)
        self.check()


def prepare_for_ros() -> None:
    """Set HOME: without it, rclpy has no folder for its logs and ends the process."""
    os.environ.setdefault("HOME", os.path.expanduser("~"))


def open_in_browser(address: str) -> None:
    """Open an address in a browser where there is a desktop; one in the terminal would block it."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(address)


class LastingOutput:
    """Standard output for work that must continue even if it can no longer be written."""

    def __init__(self) -> None:
        """Keep the current standard output."""
        self._stream = sys.stdout

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the standard output."""
        return getattr(self._stream, name)

    def write(self, text: str) -> None:
        """Write text, or drop it."""
        with _dropped(self._stream):
            self._stream.write(text)

    def flush(self) -> None:
        """Write the buffer, or drop it."""
        with _dropped(self._stream):
            self._stream.flush()


@contextlib.contextmanager
def _dropped(stream: Any) -> Iterator[None]:
    """Drop output that cannot be written; the interpreter would retry at exit."""
    try:
        yield
    except OSError:  # a full disk, or the terminal or reader is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def say(program: str, sentence: str) -> None:
    """Print a sentence on stderr if there is one."""
    if sentence and sys.stderr is not None:
        with _dropped(sys.stderr):
            print(f"{program}: {sentence}", file=sys.stderr, flush=True)


def os_sentence(error: OSError) -> str:
    """Return the meaning of an operating system error in one sentence."""
    where = (
        f"'{error.filename}' cannot be used" if error.filename else "it cannot be read or written"
    )
    reason = error.strerror or str(error) or type(error).__name__
    return f"{where}: {reason}."


def _explained(error: BaseException) -> tuple[str, int | None]:
    """Return sentence and exit code of an error; no code for a bug."""
    if number := _signal_behind(error):
        how = "interrupted." if number == signal.SIGINT else f"ended by {number.name}."
        return how, 128 + number
    # If the reader of our output is gone, Typer and Rich raise SystemExit.
    cause = error.__context__ if isinstance(error, SystemExit) else error
    if isinstance(cause, BrokenPipeError):
        return "", 0
    if isinstance(error, TactileHandError):
        return str(error), EXIT_REFUSED
    if isinstance(error, OSError):
        return os_sentence(error), EXIT_REFUSED
    if isinstance(error, ImportError) and re.search("rclpy|ament", f"{error.name} {error.path}"):
        return (
            f"ROS 2 cannot be loaded by Python {sys.version_info.major}.{sys.version_info.minor} "
            f"({str(error).splitlines()[0]}); install its wheels, or start a new shell if this one "
            "has sourced another ROS.",
            EXIT_REFUSED,
        )
    if hasattr(error, "show") and hasattr(error, "exit_code"):  # wrong usage or a help request
        error.show()
        return "", int(error.exit_code)
    return "", None


def _signal_behind(error: BaseException | None) -> signal.Signals | None:
    """Return the signal that ended a command; what it interrupted may have failed of it."""
    while error is not None:
        if isinstance(error, _Signalled):
            return signal.Signals(error.args[0])
        if isinstance(error, KeyboardInterrupt):
            return signal.SIGINT
        error = error.__context__
    return None
