# SPDX-License-Identifier: Apache-2.0
"""The file under an MCAP writer."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
from pathlib import Path


class ChunkStream:
    """Unbuffered file: what was written is with the operating system when `write` returns.

    The MCAP writer collects whole chunks itself, so a buffer would only delay them. It can also be
    cut back to a whole record after a write that failed half-way, which a buffered file cannot.

    The file is locked while it is open, so that it is not taken for one that was cut off; the lock
    ends with the process, however that dies.
    """

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist.

        Raises:
            OSError: If it cannot be created.
        """
        self._file = io.FileIO(path, "x")
        self._position = 0
        with contextlib.suppress(OSError):  # a file system without locks can still be written
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    def write(self, data: bytes | memoryview) -> int:
        """Write all of `data`.

        Raises:
            OSError: If the disk is full or gone.
        """
        rest = memoryview(data)
        while rest:
            written = self._file.write(rest)
            self._position += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def abandon(self, size: int) -> None:
        """Cut the file to `size` bytes and close it; never raises, as it follows a failure."""
        with contextlib.suppress(OSError):
            if not self.closed:
                os.ftruncate(self._file.fileno(), size)
        with contextlib.suppress(OSError):
            self._file.close()


def is_being_written(path: Path) -> bool:
    """Return whether a living process has the file open as a `ChunkStream`."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # no locks here, so none is held
            return False
    return False
