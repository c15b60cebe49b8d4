# SPDX-License-Identifier: Apache-2.0
"""Give back the memory of the compiler's own code once everything compiled is loaded."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_LIBRARY = "libllvmlite"
_DONTNEED = 4  # MADV_DONTNEED of madvise(2), the same on all Linux platforms


def release_compiler() -> None:
    """Drop the pages of LLVM's code, some 40 MiB, from this process.

    Loading what Numba has compiled runs through all of LLVM, and running it needs none of it. The
    pages are read only: if a function is compiled after all, the kernel maps them again from its
    cache. Where the system is not Linux, or LLVM is not loaded, nothing happens.
    """
    for begin, size in _code_of(_LIBRARY):
        libc = ctypes.CDLL(None)
        libc.madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
        libc.madvise(begin, size, _DONTNEED)


def _code_of(library: str) -> Iterator[tuple[int, int]]:
    """Yield address and size of the mappings of a library that can be executed but not written."""
    if not _MAPS.exists():
        return
    for line in _MAPS.read_text().splitlines():
        addresses, permissions, *_ = line.split()
        if permissions == "r-xp" and library in line:
            begin, end = (int(address, 16) for address in addresses.split("-"))
            yield begin, end - begin
