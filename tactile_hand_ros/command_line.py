# SPDX-License-Identifier: Apache-2.0
"""What every command line of this package does alike: one sentence for each error, and its code."""

from __future__ import annotations

import difflib
import errno
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from tactile_hand_ros.errors import TactileHandError

EXIT_REFUSED = 2
EXIT_INTERRUPTED = 130

_ADVICE = {
    errno.ENOSPC: "; free some space or write elsewhere",
    errno.EDQUOT: "; free some space or write elsewhere",
    errno.EACCES: "; check the permissions",
    errno.EPERM: "; check the permissions",
    errno.EROFS: "; write elsewhere",
}


def run_command(program: str, command: Callable[[], Any]) -> int:
    """Run a command and return its exit code.

    Args:
        program: Name of the program, put before each sentence.
        command: Returns an exit code, or anything else for success.

    Returns:
        0 after success, 2 with one sentence on stderr when something was refused or could not be
        read or written, 130 after Ctrl-C.
    """
    if sys.stdout is None:
        say(program, "the standard output is closed; redirect it to a file or to /dev/null.")
        return EXIT_REFUSED
    _print_any_character()
    try:
        code = command()
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has left
        _drop_output()
        return 0
    except KeyboardInterrupt:
        say(program, "interrupted.")
        return EXIT_INTERRUPTED
    except Exception as error:
        sentence, code = _explained(error)
        if not sentence and code is None:
            raise  # a defect
        _drop_unwritten()
        say(program, sentence)
    return code if isinstance(code, int) else 0


def say(program: str, sentence: str) -> None:
    """Print a sentence on stderr, where there is one."""
    if sentence and sys.stderr is not None:
        try:
            print(f"{program}: {sentence}", file=sys.stderr, flush=True)
        except OSError:  # the terminal is gone
            _redirect(sys.stderr, os.devnull)


def os_sentence(error: OSError) -> str:
    """Return what an error of the operating system means, in one sentence."""
    where = (
        f"'{error.filename}' cannot be used" if error.filename else "it cannot be read or written"
    )
    reason = error.strerror or str(error) or type(error).__name__
    return f"{where}: {reason}{_ADVICE.get(error.errno or 0, '')}."


def nearest(wrong: str, valid: Sequence[str]) -> str:
    """Return ", did you mean 'this'?" or a full stop."""
    near = difflib.get_close_matches(wrong, valid, n=1)
    return f", did you mean '{near[0]}'?" if near else "."


def _explained(error: Exception) -> tuple[str, int | None]:
    """Return sentence and exit code of an error; no code if it is a defect."""
    if isinstance(error, TactileHandError):
        return str(error), EXIT_REFUSED
    if isinstance(error, OSError):
        return os_sentence(error), EXIT_REFUSED
    return _usage(error)


def _usage(error: Any) -> tuple[str, int | None]:
    """Return what is wrong with the options, as Click reports it; no code for other errors."""
    if type(error).__name__ == "Abort":  # how Click passes on a Ctrl-C
        return "interrupted.", EXIT_INTERRUPTED
    if not hasattr(error, "format_message") or not hasattr(error, "exit_code"):
        return "", None
    message = error.format_message().rstrip(".")
    if not message:  # without any argument help was printed instead
        return "", int(error.exit_code)
    if hasattr(error, "possibilities"):
        message = f"there is no option {error.option_name}"
        message += nearest(error.option_name, _options(error.ctx))
    elif not message.endswith("?"):
        message += "."
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else ""
    return f"{message} See `{path} --help`." if path else message, int(error.exit_code)


def _options(context: Any) -> list[str]:
    """Return the names of all options of a command."""
    return [name for each in context.command.params for name in each.opts if name[:1] == "-"]


def _print_any_character() -> None:
    """Write what the terminal's encoding lacks as an escape, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _drop_unwritten() -> None:
    """Forget output that cannot be written; the interpreter would try again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        _drop_output()


def _drop_output() -> None:
    _redirect(sys.stdout, os.devnull)


def _redirect(stream: Any, path: str) -> None:
    os.dup2(os.open(path, os.O_WRONLY), stream.fileno())
