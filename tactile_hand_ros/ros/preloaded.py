# SPDX-License-Identifier: Apache-2.0
"""Executables that start at once: a process that has loaded their modules becomes one by forking.

Until its first tick a node spends most of its time loading modules, and all nodes load much the
same. So one process loads for all of them and forks. What the child runs is the file that
``ros2 run`` would start, with arguments, environment, session, output and command line of its own,
and it is a child of the process that has asked for it.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import importlib
import os
import pickle
import runpy
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

_PROGRAM = f"""
import sys
sys.path = [path for path in sys.path if path]
from {__name__} import main
main()
"""
_ROOM = 8192
"""Bytes of a command line that a child can show as its own."""

_MOST_NAMED = 256  # bytes of the first line, which names the interpreter
_LARGEST = 1 << 17  # bytes of a request
_NUMBER = struct.Struct("<i")  # of a process
_ADOPT = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)
_LOST = 255
"""Exit code of a child whose true one cannot be known."""


class Preloaded:
    """A process that loads modules and then becomes executables when it is asked to."""

    def __init__(self, modules: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start it, without waiting until all is loaded.

        Args:
            modules: Names of the modules that the executables need.
            environment: What its environment begins with, as others see it from outside.
        """
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        arguments = [str(theirs.fileno()), ",".join(modules), " " * _ROOM]
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, *arguments],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env=dict(environment),
                start_new_session=True,
            )

    def start(
        self, command: Sequence[str], *, stdout: IO[bytes], env: Mapping[str, str], **_: Any
    ) -> Forked:
        """Become an executable in a session of its own; called like `subprocess.Popen`.

        Args:
            command: An executable and its arguments; only one in Python gains by it.
            stdout: Where it writes, errors as well.
            env: Its environment.

        Raises:
            OSError: If the process that forks has ended.
        """
        request = pickle.dumps((list(command), dict(env)))
        adopt = ctypes.CDLL(None).prctl
        adopt(_ADOPT, 1, 0, 0, 0)
        try:
            socket.send_fds(self._socket, [request], [stdout.fileno()])
            (pid,) = _NUMBER.unpack(self._received())
            self._received()  # now the child is ours
        finally:
            adopt(_ADOPT, 0, 0, 0, 0)
        return Forked(pid)

    def _received(self) -> bytes:
        message = self._socket.recv(_NUMBER.size)
        if not message:
            raise BrokenPipeError("the process that forks has ended")
        return message

    def close(self) -> None:
        """End the process, whatever it is doing; its children go on."""
        self._process.kill()
        self._process.wait()
        self._socket.close()


class Forked:
    """A child of a `Preloaded`, as far as it is used like a `subprocess.Popen`."""

    def __init__(self, pid: int) -> None:
        """Take its process id."""
        self.pid = pid
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, negative after a signal, None while it runs."""
        if self._code is None:
            try:
                ended, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:
                self._code = _LOST
            else:
                self._code = os.waitstatus_to_exitcode(status) if ended else None
        return self._code

    def send_signal(self, number: int) -> None:
        """Send a signal to the process alone."""
        if self.poll() is None:
            os.kill(self.pid, number)


class _Job(NamedTuple):
    """What a child is to be.

    Attributes:
        command: Executable and arguments.
        environment: Its variables.
        output: File descriptor of its output.
    """

    command: list[str]
    environment: dict[str, str]
    output: int

    def run(self) -> None:
        """Become it, and end with its exit code.

        Exit handlers of C libraries would wait for threads that have not been forked.
        """
        self._take_over()
        if not _is_python(self.command[0]):
            os.execve(self.command[0], self.command, self.environment)
        code = 0
        try:
            runpy.run_path(self.command[0], run_name="__main__")
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except KeyboardInterrupt:  # as of any Python that has not loaded its handlers yet
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGINT)
        except BaseException as error:
            sys.excepthook(type(error), error, error.__traceback__)
            code = 1
        atexit._run_exitfuncs()
        sys.stdout.flush()
        os._exit(code)

    def _take_over(self) -> None:
        os.setsid()
        nothing = os.open(os.devnull, os.O_RDONLY)
        for number, source in enumerate((nothing, self.output, self.output)):
            os.dup2(source, number)
        os.closerange(3, os.sysconf("SC_OPEN_MAX"))
        os.environ.clear()
        os.environ.update(self.environment)
        _show_as(["python3", *self.command])
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        sys.argv = list(self.command)


def main() -> None:
    """Load, then fork until the other end of the socket is closed."""
    # A Ctrl-C goes to all processes of a run. This one waits for the end of the others,
    # and what is sent to a child before it has a handler must not be lost.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    gc.disable()
    number, modules = int(sys.argv[1]), sys.argv[2].split(",")
    for module in modules:
        with contextlib.suppress(Exception):  # the executable will say it
            importlib.import_module(module)
    gc.freeze()  # or a collection in a child would copy every page
    job = _serve(socket.socket(fileno=number))
    if job is not None:
        job.run()


def _serve(connection: socket.socket) -> _Job | None:
    """Fork on request; return in a child, and at the end.

    A process in between forks the child and ends, so that the child is adopted by who has asked.
    """
    while True:
        data, descriptors, *_ = socket.recv_fds(connection, _LARGEST, 1)
        if not data:
            return None
        between = os.fork()
        if not between:
            child = os.fork()
            if not child:
                return _Job(*pickle.loads(data), *descriptors)
            _tell(connection, child)
            os._exit(0)
        os.waitpid(between, 0)
        os.close(descriptors[0])
        _tell(connection, between)


def _tell(connection: socket.socket, process: int) -> None:
    with contextlib.suppress(OSError):  # the end of the connection is noticed by reading
        connection.send(_NUMBER.pack(process))


def _is_python(program: str) -> bool:
    with open(program, "rb") as file:
        return b"python" in file.readline(_MOST_NAMED)


def _show_as(command: Sequence[str]) -> None:
    """Let ps and pkill see this command line, in the place of the one that was forked."""
    status = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    begin, end = int(status[45]), int(status[46])  # arg_start and arg_end of proc(5)
    line = b"\0".join(map(os.fsencode, command))[: end - begin - 1]
    ctypes.memmove(begin, line.ljust(end - begin, b"\0"), end - begin)
