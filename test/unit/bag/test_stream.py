# SPDX-License-Identifier: Apache-2.0
"""A file is locked while it is written, wherever there are locks, and can be cut back."""

from __future__ import annotations

import errno
import fcntl
from pathlib import Path

import pytest

from tactile_hand_ros.bag.stream import ChunkStream, is_being_written


def test_a_file_is_being_written_until_it_is_closed(tmp_path: Path) -> None:
    stream = ChunkStream(tmp_path / "file")
    assert is_being_written(tmp_path / "file") and not stream.closed
    assert stream.write(b"abc") == 3 and stream.write(memoryview(b"de")) == 2
    assert stream.tell() == 5 and (tmp_path / "file").read_bytes() == b"abcde"
    stream.close()
    assert not is_being_written(tmp_path / "file") and stream.closed
    stream.abandon(1)  # closed already: nothing is cut off
    assert (tmp_path / "file").read_bytes() == b"abcde"
    with pytest.raises(FileExistsError):
        ChunkStream(tmp_path / "file")


def test_what_is_abandoned_ends_where_it_should(tmp_path: Path) -> None:
    stream = ChunkStream(tmp_path / "file")
    stream.write(b"abcde")
    stream.abandon(2)
    assert stream.closed and (tmp_path / "file").read_bytes() == b"ab"


def test_a_file_system_without_locks_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    stream = ChunkStream(tmp_path / "file")
    assert stream.write(b"abc") == 3
    assert not is_being_written(tmp_path / "file")
    stream.close()


def test_several_readers_may_look_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (tmp_path / "file").open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_SH | fcntl.LOCK_NB)
        assert not is_being_written(tmp_path / "file")
