# SPDX-License-Identifier: Apache-2.0
"""Files and links that take their place in one step: a reader sees the old one or the new one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Write a text file, or leave what was there.

    Raises:
        OSError: If it cannot be written.
    """
    replace_bytes(path, text.encode())


def replace_bytes(path: Path, data: bytes) -> None:
    """Write a file, or leave what was there.

    Raises:
        OSError: If it cannot be written.
    """
    with draft_of(path) as draft, draft.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())  # or a crash of the machine could leave an empty file


def replace_link(link: Path, target: str) -> None:
    """Point a symbolic link to a target, or leave it as it was.

    Raises:
        OSError: If it cannot be created.
    """
    with draft_of(link) as draft:
        draft.symlink_to(target)


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Provide a neighbour's name; what is created there replaces `path`, or is removed on errors.

    The name cannot be guessed and must not exist when it is created, so nothing that another user
    has put into the folder is followed or overwritten.
    """
    draft = path.with_name(f".{path.name}.{os.urandom(8).hex()}")
    try:
        yield draft
        draft.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise
