# SPDX-License-Identifier: Apache-2.0
"""Memory that is there when a tick needs it: locked, with a stack that is in use already.

Everything that asks the C library or the kernel for this is in this file.
"""

from __future__ import annotations

import ctypes
import os
import resource

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
