# SPDX-License-Identifier: Apache-2.0
"""Atomic replacement of files and links: a reader sees either the old or the new one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Replace a text file atomically, or raise OSError."""
    with draft_of(path) as draft, draft.open("xb") as file:
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())  # otherwise a system crash could leave an empty file


def replace_link(link: Path, target: str) -> None:
    """Replace a symbolic link atomically, or raise OSError."""
    with draft_of(link) as draft:
        draft.symlink_to(target)


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Provide a temporary path; a file created there replaces `path`, or is removed on errors.

    Its name cannot be guessed and must not exist yet, so no file or link that another user has
    placed in the folder is followed or overwritten.
    """
    draft = path.with_name(f".{path.name}.{os.urandom(8).hex()}")
    try:
        yield draft
        draft.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise
