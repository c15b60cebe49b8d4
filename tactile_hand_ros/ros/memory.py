# SPDX-License-Identifier: Apache-2.0
"""A bound on the memory of a node, which a damaged request could otherwise exhaust.

The C code that reads messages believes the length of a sequence before it has seen the elements. A
request of six bytes then asks for gigabytes and occupies the process for half a minute. Beyond the
bound such an allocation fails at once, and the request is refused like any other that is damaged.
"""

from __future__ import annotations

import resource
from pathlib import Path

ROOM = 512 * 2**20
"""What a process may grow by while it runs [bytes]: a hundred messages of a megabyte in some of its
queues, and what a tick needs."""


def bound_memory(room: int = ROOM) -> None:
    """Let the data of this process grow by so many bytes from now on, and no further.

    A lower limit that is in force already stays.
    """
    limit = _data_bytes() + room
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    known = [value for value in (soft, hard) if value != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([limit, *known]), hard))


def _data_bytes() -> int:
    """Return the size of the private writable memory of this process, as the limit counts it."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmData:"):
            return 1024 * int(line.split()[1])
    raise OSError("/proc/self/status does not tell VmData; expected Linux")
