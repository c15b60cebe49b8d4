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
from contextlib import contextmanager, suppress
from pathlib import Path

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # mlockall(2): lock pages once they are in use, no sooner
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX = -1, -2, -4  # mallopt(3)
_PAD = 2 * 2**20  # bytes that each heap has in hand; they are not in use before they are needed
_MUCH = 2**20  # bytes left behind that are worth the time to return them
_ORDINARY = 128 * 1024  # free bytes at the top of a heap from which it is cut, unless it is kept
_LARGE = 100 * 1024  # bytes whose return makes the C library look at the top of a heap
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


def pad_heaps() -> None:
    """Let each heap have memory in hand, and return large blocks to the system when they are freed.

    Call it before there are threads. While `bounded_memory` is in force, a thread of the middleware
    that needs more than its heap has would end the process. The C library then no longer
    raises the size from which blocks are returned; it would keep up to 64 MB a heap.
    """
    _mallopt(_TOP_PAD, _PAD)


def keep_heap() -> None:
    """Let the C library keep memory that is freed: to return it means to fault it in again."""
    global _keeps
    _keeps = True
    _mallopt(_TRIM_THRESHOLD, -1)
    _mallopt(_MMAP_MAX, 0)


_keeps = False


def _mallopt(option: int, value: int) -> None:
    with suppress(OSError, AttributeError):  # a C library without mallopt
        ctypes.CDLL(None).mallopt(option, value)


def _return_memory() -> None:
    """Return free memory to the system, that of the heap that this thread uses included.

    A thread whose heap may not grow goes on in another one, whose top `malloc_trim` leaves alone.
    """
    _mallopt(_TRIM_THRESHOLD, _ORDINARY)
    with suppress(OSError, AttributeError):  # a C library without malloc_trim
        library = ctypes.CDLL(None)
        library.malloc_trim(0)
        library.malloc.restype, library.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
        library.free(library.malloc(_LARGE))
    if _keeps:
        _mallopt(_TRIM_THRESHOLD, -1)


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
    What the block leaves behind in the heap is returned; the next one would take as much again.
    """
    before, in_use = resource.getrlimit(resource.RLIMIT_DATA), _status("RssAnon")
    bound_memory(room)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        if _status("RssAnon") > in_use + _MUCH:
            _return_memory()


def _data_bytes() -> int:
    """Return the size of the private writable memory of this process, as the limit counts it."""
    return _status("VmData")


def _status(name: str) -> int:
    """Return a size that the kernel knows of this process [bytes]."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"/proc/self/status has no line {name}; expected Linux")
