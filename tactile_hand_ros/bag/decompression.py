# SPDX-License-Identifier: Apache-2.0
"""Decompression with an end: 8 kB can stand for 256 MB, and sizes in files need not be true."""

from __future__ import annotations

import lz4.frame
import zstandard

LARGEST = 2**28
"""Largest chunk, record or file of a bag that is taken into memory, after decompression [B]."""

_PIECE = 512  # bytes that are decompressed at a time where the rest may be broken
_ERRORS = (zstandard.ZstdError, RuntimeError, EOFError, MemoryError)


def unpack(packed: bytes, compression: str, limit: int) -> bytes:
    """Decompress as far as possible.

    Args:
        packed: Compressed data, which may be cut off or broken.
        compression: ``zstd``, ``lz4`` or empty for none; of any other there is no result.
        limit: Number of bytes that are expected [B].

    Returns:
        What was decompressed; more than `limit` bytes where there are more, but not all of those.
    """
    if compression == "":
        return packed
    if compression == "zstd":
        return _unzstd(packed, limit)
    return _unlz4(packed, limit) if compression == "lz4" else b""


def _unzstd(packed: bytes, limit: int) -> bytes:
    decoder = zstandard.ZstdDecompressor(max_window_size=LARGEST)
    try:
        if zstandard.frame_content_size(packed) == limit:
            return decoder.decompress(packed)
    except _ERRORS:
        pass
    return _in_pieces(packed, decoder.decompressobj(), limit)


def _unlz4(packed: bytes, limit: int) -> bytes:
    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=limit + 1))
    except _ERRORS:
        return _in_pieces(packed, lz4.frame.LZ4FrameDecompressor(), limit)


def _in_pieces(
    packed: bytes,
    decoder: zstandard.ZstdDecompressionObj | lz4.frame.LZ4FrameDecompressor,
    limit: int,
) -> bytes:
    """Decompress piece by piece, until the data ends, makes no sense or is too much."""
    out = bytearray()
    try:
        for at in range(0, len(packed), _PIECE):
            out += decoder.decompress(packed[at : at + _PIECE])
            if len(out) > limit:
                break
    except _ERRORS:
        pass  # what came before is good
    return bytes(out)
