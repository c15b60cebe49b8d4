# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file, which may be cut off or damaged.

mcap's `StreamReader` builds an object of each entry of each index; for bags of millions of
messages that takes longer than everything else.

Source: MCAP specification, records.
"""

from __future__ import annotations

import contextlib
import io
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = struct.Struct("<H4xQQ")  # channel, log time, publish time; the data follow
LARGEST = 2**28
"""Largest chunk that is decompressed [B]; what announces more is damaged."""

_HEAD = struct.Struct("<BQ")  # opcode, length

Data = bytes | mmap.mmap


@contextlib.contextmanager
def mapped(file: Path) -> Iterator[Data]:
    """Give access to the bytes of a file without reading all of it."""
    with file.open("rb") as stream:
        if not file.stat().st_size:  # cannot be mapped
            yield b""
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def records(data: Data, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and stop of records that follow each other, up to one that is cut off."""
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        start, at = at + _HEAD.size, at + _HEAD.size + length
        if not opcode or at > len(data):
            return
        yield opcode, start, at


def parse(kind: Any, data: bytes) -> Any:
    """Return a record of a class of `mcap.records`."""
    return kind.read(ReadDataStream(io.BytesIO(data)))


def unpacked(data: bytes) -> bytes:
    """Return the records in a chunk.

    Raises:
        ValueError: If they are damaged or larger than `LARGEST`; other errors of the parsers.
    """
    chunk: Chunk = parse(Chunk, data)
    if chunk.uncompressed_size > LARGEST:
        raise ValueError(f"a chunk announces {chunk.uncompressed_size} bytes")
    stream: Any = io.BytesIO(chunk.data)
    if chunk.compression == "zstd":  # reads no more than it is asked for, whatever the frame states
        stream = zstandard.ZstdDecompressor().stream_reader(stream)
    elif chunk.compression == "lz4":
        stream = lz4.frame.open(stream)
    found = bytes(stream.read(chunk.uncompressed_size))
    if chunk.uncompressed_crc and zlib.crc32(found) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    return found
