# SPDX-License-Identifier: Apache-2.0
"""What is read of a broken file, to the byte: files made of records by hand."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Message, Schema

from tactile_hand_ros.bag.decompression import LARGEST
from tactile_hand_ros.bag.salvage import MAGIC, Tally, salvage
from tactile_hand_ros.errors import BagError

HEAD = 9
"""Bytes of a record before its body."""


def record(opcode: int, body: bytes = b"", announced: int | None = None) -> bytes:
    """Return a record, which may announce another length than it has."""
    return struct.pack("<BQ", opcode, len(body) if announced is None else announced) + body


def text(data: bytes) -> bytes:
    """Return a text as MCAP writes it."""
    return struct.pack("<I", len(data)) + data


def message(number: int, channel: int = 1) -> bytes:
    """Return a message of 40 bytes."""
    return record(Opcode.MESSAGE, struct.pack("<HIQQ9s", channel, 0, number, number, b"x" * 9))


HEADER = record(Opcode.HEADER, text(b"ros2") + text(b"some"))
SCHEMA = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(b"T") + text(b"ros2msg") + text(b""))
CHANNEL = record(
    Opcode.CHANNEL, struct.pack("<HH", 1, 1) + text(b"/a") + text(b"cdr") + struct.pack("<I", 0)
)
DATA_END = record(Opcode.DATA_END, bytes(4))
FRONT = HEADER + SCHEMA + CHANNEL
PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}


def chunk(
    data: bytes,
    compression: str = "",
    *,
    size: int | None = None,
    checksum: int | None = None,
    packed: bytes | None = None,
) -> bytes:
    """Return a chunk, whose head may say other than what is true."""
    packed = PACK[compression](data) if packed is None else packed
    size = len(data) if size is None else size
    checksum = zlib.crc32(data) if checksum is None else checksum
    body = struct.pack("<QQQI", 0, 0, size, checksum) + text(compression.encode())
    return record(Opcode.CHUNK, body + struct.pack("<Q", len(packed)) + packed)


def footer(start: int = 0, checksum: int = 0) -> bytes:
    """Return the end of a file."""
    return record(Opcode.FOOTER, struct.pack("<QQI", start, 0, checksum)) + MAGIC


END = DATA_END + footer()


def read(tmp_path: Path, data: bytes) -> tuple[Tally, list[object]]:
    """Salvage what follows the first magic."""
    file, tally = tmp_path / "x.mcap", Tally()
    file.write_bytes(MAGIC + data)
    return tally, list(salvage(file, tally))


def test_records_come_in_their_order_and_are_counted(tmp_path: Path) -> None:
    tally, found = read(tmp_path, FRONT + message(1) + chunk(message(2) + message(3)) + END)
    assert [type(each) for each in found] == [Header, Schema, Channel, *3 * [Message]]
    assert [each.log_time for each in found if isinstance(each, Message)] == [1, 2, 3]
    assert tally == Tally(3, 0, True, "", {"/a": 3}) and tally.intact


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_a_chunk_counts_with_or_without_a_checksum_and_not_with_a_wrong_one(
    tmp_path: Path, compression: str
) -> None:
    data = message(1) + message(2)
    for checksum, left in ((None, 0), (0, 0), (zlib.crc32(data) ^ 1, len(data))):
        whole = chunk(data, compression, checksum=checksum)
        tally, _ = read(tmp_path, FRONT + whole + END)
        assert (tally.left, tally.messages) == (left, 0 if left else 2)
        assert tally.complete and tally.intact == (not left)


@pytest.mark.parametrize("size", [79, 81, LARGEST])
def test_a_chunk_of_another_size_than_it_announces_is_left(tmp_path: Path, size: int) -> None:
    tally, _ = read(tmp_path, FRONT + chunk(message(1) + message(2), size=size) + message(3) + END)
    assert (tally.left, tally.messages, tally.oversized) == (size, 1, "")


def test_a_chunk_above_the_limit_costs_the_bytes_that_it_has(tmp_path: Path) -> None:
    first = chunk(message(1), size=LARGEST + 1)
    second = chunk(message(2), size=LARGEST + 2)
    tally, _ = read(tmp_path, FRONT + first + second + message(3) + END)
    assert (tally.left, tally.messages) == (80, 1)
    at = len(MAGIC + FRONT)
    expected = f"the chunk at byte {at} announces {LARGEST + 1} bytes, at most {LARGEST} are read"
    assert tally.oversized == expected


@pytest.mark.parametrize("above", [0, 1])
def test_of_a_chunk_that_was_cut_off_the_front_is_used(tmp_path: Path, above: int) -> None:
    """Also where it announces too much: what does not fit is not there."""
    data = b"".join(message(i) for i in range(10))
    whole = chunk(data, size=LARGEST + above)
    tally, found = read(tmp_path, FRONT + whole[:-50])
    assert tally.messages == 8 and len(found) == 11
    assert tally.left == (len(data) - 50 - 8 * 40 if above else LARGEST - 8 * 40)
    assert bool(tally.oversized) == bool(above) and not tally.complete


def test_a_cut_chunk_of_which_more_is_used_than_it_has_leaves_nothing(tmp_path: Path) -> None:
    data = b"".join(message(7) for _ in range(1000))
    whole = chunk(data, "zstd", size=LARGEST + 1)
    tally, _ = read(tmp_path, FRONT + record(Opcode.CHUNK, whole[HEAD:], len(whole)))
    assert (tally.messages, tally.left) == (1000, 0)


@pytest.mark.parametrize("length", [0, 5, 31])
def test_a_chunk_without_its_head_costs_its_bytes(tmp_path: Path, length: int) -> None:
    whole = chunk(message(1))
    tally, _ = read(tmp_path, FRONT + whole[: HEAD + length])
    assert (tally.messages, tally.left, tally.complete) == (0, length, False)
    tally, _ = read(tmp_path, FRONT + record(Opcode.CHUNK, whole[HEAD : HEAD + length]) + END)
    assert (tally.messages, tally.left, tally.complete) == (0, length, True)


def test_a_name_of_a_compression_that_is_no_text_costs_its_chunk(tmp_path: Path) -> None:
    broken = bytearray(chunk(message(1), "zstd"))
    broken[broken.index(b"zstd")] = 0xFF
    tally, _ = read(tmp_path, FRONT + broken + message(2) + END)
    assert (tally.messages, tally.left) == (1, len(broken) - HEAD)


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [(["lz4", "zstd"], "lz4"), (["", "zstd"], ""), (["gzip", "zstd", "lz4"], "zstd"), ([], "")],
)
def test_the_compression_is_that_of_the_first_known_chunk(
    tmp_path: Path, kinds: list[str], expected: str
) -> None:
    chunks = [
        chunk(message(1), kind, packed=None if kind in PACK else message(1)) for kind in kinds
    ]
    tally, _ = read(tmp_path, FRONT + b"".join(chunks) + END)
    assert tally.compression == expected


def test_records_of_other_kinds_are_passed_over_also_empty_ones(tmp_path: Path) -> None:
    other = record(0x7F)
    data = FRONT + other + chunk(message(1) + other) + record(0x80, b"abc") + END
    tally, found = read(tmp_path, data)
    assert tally.intact and len(found) == 4


@pytest.mark.parametrize("cut", [1, 30, 39])
def test_a_record_that_was_cut_off_costs_what_is_there_of_it(tmp_path: Path, cut: int) -> None:
    tally, _ = read(tmp_path, FRONT + message(1) + message(2)[:-cut])
    assert (tally.messages, tally.left, tally.complete) == (1, 40 - cut, False)
    tally, _ = read(tmp_path, FRONT + chunk(message(1) + message(2)[:-cut]) + message(3) + END)
    assert (tally.messages, tally.left, tally.complete) == (2, 40 - cut, True)


def test_zeros_end_a_file_and_a_chunk(tmp_path: Path) -> None:
    tally, _ = read(tmp_path, FRONT + message(1) + bytes(50) + message(2))
    assert (tally.messages, tally.left, tally.complete) == (1, 90, False)
    tally, _ = read(tmp_path, FRONT + chunk(message(1) + bytes(50) + message(2)) + END)
    assert (tally.messages, tally.left, tally.complete) == (1, 90, True)


def test_a_record_that_is_damaged_or_refers_to_nothing_costs_its_bytes(tmp_path: Path) -> None:
    damaged = record(Opcode.CHANNEL, struct.pack("<HHI", 2, 1, 10**6))
    orphan = record(Opcode.CHANNEL, struct.pack("<HHIII", 2, 9, 0, 0, 0))
    bare = record(Opcode.CHANNEL, struct.pack("<HHIII", 3, 0, 0, 0, 0))  # 0: without a schema
    data = FRONT + damaged + orphan + bare + message(1, 3) + message(2, 2) + message(3) + END
    tally, _ = read(tmp_path, data)
    lost = len(damaged) + len(orphan) + 40 - 3 * HEAD
    assert (tally.left, tally.messages, tally.complete) == (lost, 2, True)


@pytest.mark.parametrize("above", [0, 1])
def test_a_record_above_the_limit_is_named_and_one_at_the_limit_only_cut_off(
    tmp_path: Path, above: int
) -> None:
    for opcode in (Opcode.METADATA, Opcode.CHUNK):
        tally, _ = read(tmp_path, FRONT + record(opcode, bytes(60), LARGEST + above))
        expected = (
            f"the record at byte {len(MAGIC + FRONT)} announces {LARGEST + 1} bytes, "
            f"at most {LARGEST} are read"
        )
        is_named = above and opcode == Opcode.METADATA
        assert tally.oversized == (expected if is_named else "")
        assert not tally.complete and tally.messages == 0


@pytest.mark.parametrize("start", [0, 40])
def test_a_file_is_complete_with_the_checksum_of_its_index_or_without_one(
    tmp_path: Path, start: int
) -> None:
    front = FRONT + message(1) + DATA_END
    body = MAGIC + front + record(Opcode.FOOTER, struct.pack("<QQ", start, 0), 20)
    right = zlib.crc32(body[start:])
    for checksum, complete in ((0, True), (right, True), (right ^ 1, start == 0)):
        tally, _ = read(tmp_path, front + footer(start, checksum))
        assert tally.complete == complete and tally.messages == 1


def test_a_checksum_is_taken_over_an_index_of_any_size(tmp_path: Path) -> None:
    front = FRONT + DATA_END
    start = len(MAGIC + front)
    index = record(0x0B, b"i" * (2**20 + 7))
    covered = index + record(Opcode.FOOTER, struct.pack("<QQ", start, 0), 20)
    tally, _ = read(tmp_path, front + index + footer(start, zlib.crc32(covered)))
    assert tally.complete


@pytest.mark.parametrize("wrong", ["opcode", "magic", "start", "short", "none"])
def test_a_file_with_another_end_is_not_complete(tmp_path: Path, wrong: str) -> None:
    end = bytearray(footer(10**6 if wrong == "start" else 0))
    if wrong == "opcode":
        end[0] = 0x0F
    elif wrong == "magic":
        end[-1] ^= 1
    elif wrong == "short":
        end = end[1:]
    elif wrong == "none":
        end.clear()
    tally, _ = read(tmp_path, FRONT + message(1) + DATA_END + end)
    assert (tally.complete, tally.left, tally.messages) == (False, 0, 1)


def test_the_shortest_files(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    for size in range(len(MAGIC) + 1):
        file.write_bytes(MAGIC[:size])
        tally = Tally()
        assert list(salvage(file, tally)) == [] and tally == Tally()
    tally, found = read(tmp_path, record(Opcode.DATA_END))
    assert found == [] and tally == Tally()
    tally, found = read(tmp_path, END)
    assert found == [] and tally.intact
    file.write_bytes(b"\x89MCAP1\r\n" + END)
    with pytest.raises(BagError, match="x.mcap is not an MCAP file"):
        list(salvage(file, Tally()))
