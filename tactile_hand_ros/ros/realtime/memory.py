# SPDX-License-Identifier: Apache-2.0
"""Memory that is there when a tick needs it, and that no message can use up.

Pages are locked, a stack is in use already, and what a process may grow by is bounded.

Everything that asks the C library or the kernel for this is in this file.
"""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # mlockall(2): lock pages once they are in use, no sooner
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # mallopt(3)
_STACK_BYTES = 256 * 1024
_ADVICE = "run as root, or set memlock to unlimited in /etc/security/limits.conf"


class _Block(ctypes.Structure):
    """An argument that is passed by value, that is on the stack."""

    _fields_ = [("bytes", ctypes.c_char * _STACK_BYTES)]


def lock_memory() -> str:
    """Keep the pages of this process in memory, and those that it will use.

    Locking with a limit would let later allocations fail, so it is not done then.

    Returns:
        Empty if they are locked, else why not and what to do.
    """
    if not _is_unlimited():
        return f"the limit of locked memory is too low: {_ADVICE}"
    try:
        library = ctypes.CDLL(None, use_errno=True)
        failed = library.mlockall(_CURRENT | _FUTURE | _ON_FAULT)
    except (OSError, AttributeError):
        return "this system has no mlockall"
    return f"{os.strerror(ctypes.get_errno())}: {_ADVICE}" if failed else ""


def _is_unlimited() -> bool:
    """Return whether this process may lock all that it has; root may whatever the limit."""
    _, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if hard == resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    return hard == resource.RLIM_INFINITY or os.geteuid() == 0


def keep_heap() -> None:
    """Let the C library keep memory that is freed: to return it means to fault it in again."""
    try:
        library = ctypes.CDLL(None)
        library.mallopt(_TRIM_THRESHOLD, -1)
        library.mallopt(_MMAP_MAX, 0)
    except (OSError, AttributeError):  # a C library without mallopt
        return


def touch_stack() -> None:
    """Use a part of this thread's stack now, so that no tick is the first to do so."""
    call = ctypes.CDLL(None)["getppid"]
    call.argtypes = [_Block]
    call(_Block())


def bound_memory(room: int) -> None:
    """Let the data of this process grow by so many bytes from now on, and no further.

    A lower limit that is in force already stays.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    known = [value for value in (soft, hard) if value != resource.RLIM_INFINITY]
    limit = min([_data_bytes() + room, *known])
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


@contextmanager
def bounded_memory(room: int) -> Iterator[None]:
    """Let the data of this process grow by so many bytes in a block, and no further.

    The C code that reads a request believes the length of a sequence: six damaged bytes then ask
    for gigabytes and occupy the process for half a minute. Beyond the bound that fails at once.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    bound_memory(room)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _data_bytes() -> int:
    """Return the size of the private writable memory of this process, as the limit counts it."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmData:"):
            return 1024 * int(line.split()[1])
    raise OSError("/proc/self/status has no line VmData; expected Linux")
