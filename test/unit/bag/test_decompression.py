# SPDX-License-Identifier: Apache-2.0
"""Decompression gives what is there, a little more than expected at most, and never fails."""

from __future__ import annotations

import lz4.frame
import numpy as np
import pytest
import zstandard

from tactile_hand_ros.bag.decompression import unpack

# Half of it does not compress, so that its front is found in pieces.
RANDOM = 300_000
DATA = np.random.default_rng(1).bytes(RANDOM) + bytes(300_000)


def packed(kind: str, data: bytes = DATA) -> tuple[str, bytes]:
    """Return the name of the compression and the data, with or without its size in the frame."""
    if kind.startswith("lz4"):
        return "lz4", bytes(lz4.frame.compress(data, store_size=kind == "lz4"))
    sized = zstandard.ZstdCompressionParameters(write_content_size=kind == "zstd")
    return "zstd", zstandard.ZstdCompressor(compression_params=sized).compress(data)


KINDS = ["lz4", "zstd", "lz4 unsized", "zstd unsized"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("more", [0, 1, 1000])
def test_all_comes_back_where_it_fits(kind: str, more: int) -> None:
    name, data = packed(kind)
    assert unpack(data, name, len(DATA) + more) == DATA


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limit", [0, 1, RANDOM // 9, len(DATA) - 1])
def test_of_too_much_there_is_more_than_the_limit_but_not_all(kind: str, limit: int) -> None:
    long = DATA + np.random.default_rng(2).bytes(RANDOM)
    name, data = packed(kind, long)
    found = unpack(data, name, limit)
    assert limit < len(found) < len(long) and long.startswith(found)


@pytest.mark.parametrize("kind", KINDS)
def test_of_a_front_all_that_decompresses_comes_back(kind: str) -> None:
    name, data = packed(kind)
    fronts = [unpack(data[:cut], name, len(DATA)) for cut in range(0, RANDOM, 20_000)]
    sizes = [len(front) for front in fronts]
    assert sizes == sorted(sizes) and sizes[0] == 0 and sizes[-1] > RANDOM // 2
    assert all(DATA.startswith(front) for front in fronts)


def test_broken_data_gives_its_front_and_nonsense_nothing() -> None:
    name, data = packed("lz4")
    broken = data[:20_000] + b"\xff" * 100 + data[20_100:]
    assert DATA.startswith(unpack(broken, name, len(DATA))[:10_000])
    for kind in ("lz4", "zstd"):
        assert unpack(b"no such frame", kind, 100) == b""


def test_none_is_the_data_itself_and_of_an_unknown_kind_there_is_nothing() -> None:
    assert unpack(DATA, "", 1) == DATA
    assert unpack(DATA, "gzip", len(DATA)) == b""
