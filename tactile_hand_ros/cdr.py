# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (plain CDR, little-endian), read and written without rclpy.

* `header_stamp`: the timestamp of any serialized message that starts with a header.
* `tables`: all messages of a topic as arrays, for reading bags.
* `CdrTemplate`: messages with a fixed layout, written in place, for ticks.
* `ContentReader`: messages of any layout, one at a time.
* `BatchReader`: the newest messages of a topic, `packed` into one block, for viewers.

A general decoder builds a Python object per message. But the messages of a topic nearly always have
the same strings and lengths, so every number is at the same offset.

Source: OMG DDS-XTypes 1.3, 7.4 (plain CDR version 1).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.errors import MessageError

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

ENCODING = b"\x00\x01"
"""Start of plain little-endian CDR; two bytes of options follow, and the message."""
_ENCAPSULATION = ENCODING + b"\x00\x00"
_ORIGIN = len(_ENCAPSULATION)  # alignment counts from here
_STAMP = struct.Struct("<iI")
_AFTER_STAMP = _ORIGIN + _STAMP.size
_LENGTH = struct.Struct("<I")
_DOUBLE = np.dtype("<f8")
_SECOND = 1_000_000_000


def header_stamp(data: bytes) -> int:
    """Return the timestamp [ns] of a serialized message that starts with a header.

    Raises:
        MessageError: If there is none, or it is not a valid time.
    """
    if len(data) < _AFTER_STAMP or data[:2] != ENCODING:
        raise MessageError(f"{len(data)} bytes, expected a message that starts with a stamp.")
    seconds, nanoseconds = _STAMP.unpack_from(data, _ORIGIN)
    if seconds < 0 or nanoseconds >= _SECOND:
        raise MessageError(
            f"the stamp is {seconds} s and {nanoseconds} ns, expected seconds >= 0 and 0 to "
            f"{_SECOND - 1} ns."
        )
    return int(seconds * _SECOND + nanoseconds)


def packed(messages: Iterable[bytes]) -> bytes:
    """Join serialized messages, each with its length before it."""
    return b"".join([_LENGTH.pack(len(data)) + data for data in messages])


def unpacked(data: bytes) -> list[bytes]:
    """Return the messages that `packed` joined.

    Raises:
        MessageError: If lengths and data contradict each other.
    """
    at, messages = 0, list[bytes]()
    while at + _LENGTH.size <= len(data):
        start = at + _LENGTH.size
        at = start + _LENGTH.unpack_from(data, at)[0]
        messages.append(data[start:at])
    if at != len(data):
        raise MessageError(f"{len(data)} bytes that are not messages with their lengths.")
    return messages


def byte_array(data: bytes) -> bytes:
    """Return the bytes in a serialized std_msgs/UInt8MultiArray without dimensions.

    Raises:
        MessageError: If it is something else.
    """
    # Of three numbers before the bytes, that of dimensions and the offset are 0.
    start = _ORIGIN + 3 * _LENGTH.size
    count = start - _LENGTH.size
    if len(data) >= start and data[:2] == ENCODING and not any(data[_ORIGIN:count]):
        end = start + _LENGTH.unpack_from(data, count)[0]
        if end <= len(data):
            return data[start:end]
    raise MessageError(f"{len(data)} bytes, expected an array of bytes without dimensions.")


def clock_bytes(stamp_ns: int) -> bytes:
    """Return a rosgraph_msgs/Clock message."""
    return _ENCAPSULATION + _STAMP.pack(*divmod(stamp_ns, _SECOND))


class CdrTemplate:
    """The bytes of a message that starts with a timestamp, with gaps for blocks of doubles."""

    def __init__(self) -> None:
        """Start with the encapsulation and the timestamp."""
        self._buffer = bytearray(_ENCAPSULATION + bytes(_STAMP.size))
        self._blocks: list[tuple[int, int]] = []

    def _align(self, size: int) -> None:
        self._buffer += bytes(-(len(self._buffer) - _ORIGIN) % size)

    def text(self, text: str) -> CdrTemplate:
        """Append a string."""
        raw = text.encode() + b"\x00"
        self.length(len(raw))
        self._buffer += raw
        return self

    def length(self, count: int) -> CdrTemplate:
        """Append the length of a sequence."""
        self._align(_LENGTH.size)
        self._buffer += _LENGTH.pack(count)
        return self

    def doubles(self, count: int) -> CdrTemplate:
        """Append a gap for doubles; in CDR, an empty block is not aligned."""
        if count:
            self._align(_DOUBLE.itemsize)
            self._blocks.append((len(self._buffer), count))
            self._buffer += bytes(count * _DOUBLE.itemsize)
        return self

    def finish(self) -> list[Array]:
        """Return the blocks to write in place before `stamped`; no more parts can be appended."""
        return [np.frombuffer(self._buffer, _DOUBLE, count, at) for at, count in self._blocks]

    def stamped(self, stamp_ns: int) -> bytes:
        """Return the bytes with a timestamp [ns] and the current numbers of the blocks."""
        _STAMP.pack_into(self._buffer, _ORIGIN, *divmod(stamp_ns, _SECOND))
        return bytes(self._buffer)


@dataclass
class Layout:
    """Positions of the parts of a message.

    Attributes:
        texts: All strings in order; the first is the header's frame_id.
        doubles: Offset and count of each group of doubles.
        fixed: Byte ranges that are equal in all messages of this layout.
    """

    texts: list[str] = field(default_factory=list)
    doubles: dict[str, tuple[int, int]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """Messages of one layout.

    Attributes:
        rows: Indices of the messages within the topic, shape (n,).
        layout: Positions of the numbers.
        matrix: The bytes, shape (n, length).
    """

    rows: Rows
    layout: Layout
    matrix: NDArray[np.uint8]

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Header timestamps [ns], shape (n,)."""
        seconds = self._column(_ORIGIN, 4, "<i4").astype(np.int64)[:, 0]
        rest = self._column(_ORIGIN + 4, 4, "<u4").astype(np.int64)[:, 0]
        return np.asarray(seconds * _SECOND + rest, dtype=np.int64)

    def doubles(self, name: str) -> Array:
        """Return a group of doubles, shape (n, count)."""
        start, count = self.layout.doubles[name]
        return self._column(start, 8 * count, "<f8").astype(np.float64)

    def _column(self, start: int, size: int, kind: str) -> NDArray[np.generic]:
        part = np.ascontiguousarray(self.matrix[:, start : start + size])
        return part.view(kind) if size else np.empty((len(part), 0))


def is_reset(before: int, after: int) -> bool:
    """Return whether a stamp, ns, after another one shows that time was set back.

    To 0, or by more than 1 s; what is less is late or in disorder.
    """
    return after < before and (after == 0 or before - after > _SECOND)


class _Cursor:
    """Parser that walks through one message and records its layout."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, _ORIGIN
        self.layout = Layout(fixed=[(0, 2)])

    def text(self) -> None:
        size = self.length()
        raw = self._fix(size)
        self.layout.texts.append(raw.rstrip(b"\0").decode("utf-8", "replace"))

    def length(self) -> int:
        self._at += -(self._at - _ORIGIN) % 4
        return int(_LENGTH.unpack(self._fix(4))[0])

    def doubles(self, name: str, count: int) -> None:
        if count:
            self._at += -(self._at - _ORIGIN) % 8
        self.layout.doubles[name] = (self._at, count)
        self._skip(8 * count)

    def _fix(self, size: int) -> bytes:
        start = self._at
        self._skip(size)
        self.layout.fixed.append((start, self._at))
        return self._data[start : self._at]

    def _skip(self, size: int) -> None:
        self._at += size
        if self._at > len(self._data):
            raise ValueError(f"{len(self._data)} bytes, but at least {self._at} announced")

    def message(self, type_name: str) -> None:
        self._skip(_STAMP.size)
        self.text()
        if type_name == "sensor_msgs/msg/JointState":
            for _ in range(self.length()):
                self.text()
        for name, (count, is_repeated) in GROUPS[type_name].items():
            self.doubles(name, count * self.length() if is_repeated else count)


GROUPS: dict[str, dict[str, tuple[int, bool]]] = {
    "sensor_msgs/msg/Imu": {
        "orientation": (4, False),
        "rates, accelerations and covariances": (33, False),
    },
    "sensor_msgs/msg/JointState": dict.fromkeys(("position", "velocity", "effort"), (1, True)),
    "geometry_msgs/msg/PoseArray": {"poses": (7, True)},
    "geometry_msgs/msg/PoseStamped": {"pose": (7, False)},
    "geometry_msgs/msg/WrenchStamped": {"wrench": (6, False)},
}
"""Groups of doubles of each supported type, in order: their count, and whether it is repeated."""


def _layout(type_name: str, data: bytes) -> Layout:
    """Return the layout of a message.

    Raises:
        MessageError: If the bytes are not a message of that type.
    """
    cursor = _Cursor(data)
    try:
        if len(data) < _ORIGIN or data[:2] != ENCODING:
            raise ValueError(f"encoding {data[:2].hex() or 'missing'}, expected 0001")
        cursor.message(type_name)
    except ValueError as error:
        raise MessageError(f"{len(data)} bytes that are not a {type_name}: {error}.") from None
    return cursor.layout


LARGEST_MESSAGE = 65_536
"""Maximum size of a message [B]; a hand with a thousand joints needs less."""

_NONE = np.empty(0)


@dataclass(frozen=True)
class Content:
    """Content of one message: header timestamp [ns], strings as in `Layout`, groups of doubles."""

    stamp: int
    texts: list[str]
    doubles: dict[str, Array]


class ContentReader:
    """Reads messages of one type and any layout.

    The first message is parsed field by field. The next one usually has the same layout; then only
    its numbers are read.
    """

    def __init__(self, type_name: str) -> None:
        """Create a reader for one of the types in `GROUPS`."""
        self._type = type_name
        self._layout = Layout()
        self._fixed: list[tuple[slice, bytes]] = []
        self._size = -1

    def __call__(self, data: bytes) -> Content:
        """Read a message.

        Raises:
            MessageError: If there are too many bytes, or they are not a message of that type.
        """
        if len(data) != self._size or any(data[at] != same for at, same in self._fixed):
            self._find_layout(data)
        layout = self._layout
        doubles = {
            name: np.frombuffer(data, _DOUBLE, count, at).astype(np.float64) if count else _NONE
            for name, (at, count) in layout.doubles.items()
        }
        return Content(header_stamp(data), layout.texts, doubles)

    def _find_layout(self, data: bytes) -> None:
        if len(data) > LARGEST_MESSAGE:
            raise MessageError(f"{len(data)} bytes, expected at most {LARGEST_MESSAGE}.")
        layout = _layout(self._type, data)
        self._fixed = [(slice(*ends), data[slice(*ends)]) for ends in layout.fixed]
        self._layout, self._size = layout, len(data)


def tables(type_name: str, messages: Sequence[bytes]) -> Iterator[Table]:
    """Group the serialized messages of a topic by layout.

    Raises:
        MessageError: If a message is not of the given type.
    """
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        joined = b"".join([messages[row] for row in rows.tolist()])
        matrix = np.frombuffer(joined, dtype=np.uint8).reshape(len(rows), int(size))
        while len(rows):
            layout = _layout(type_name, messages[int(rows[0])])
            same = np.ones(len(matrix), dtype=np.bool_)
            for start, end in layout.fixed:
                same &= (matrix[:, start:end] == matrix[0, start:end]).all(axis=1)
            yield Table(rows[same], layout, matrix[same])
            rows, matrix = rows[~same], matrix[~same]


class BatchReader:
    """Reads stamps and some numbers of `packed` messages of one type.

    All messages of a batch nearly always have the layout of the last batch. Then they are read as
    one array.
    """

    def __init__(self, type_name: str, groups: Mapping[str, int]) -> None:
        """Read the first numbers of some groups of a type in `GROUPS`, as many as given."""
        self._type, self._groups = type_name, groups
        self._size = 0  # B, of a message and its length
        self._fixed, self._numbers = np.empty(0, np.intp), np.empty(0, np.intp)
        self._same = np.empty(0, np.uint8)

    def __call__(self, data: bytes) -> tuple[NDArray[np.int64], Array]:
        """Return header timestamps [ns], shape (n,), and numbers, shape (n, sum of the groups).

        Raises:
            MessageError: If a message is not of that type or lacks a number.
        """
        if self._size and len(data) % self._size == 0:
            matrix = np.frombuffer(data, np.uint8).reshape(-1, self._size)
            if bool((matrix.take(self._fixed, axis=1) == self._same).all()):
                return self._read(matrix)
        parts = [self._read(self._learn(message)) for message in unpacked(data)]
        return np.concatenate([part[0] for part in parts]), np.vstack([part[1] for part in parts])

    def _read(self, matrix: NDArray[np.uint8]) -> tuple[NDArray[np.int64], Array]:
        """Return timestamps and numbers of messages with the known layout, one in each row."""
        found = matrix.take(self._numbers, axis=1).view(_DOUBLE)
        times = np.ascontiguousarray(found[:, :1]).view("<i4").astype(np.int64)
        return times[:, 0] * _SECOND + times[:, 1], found[:, 1:]

    def _learn(self, message: bytes) -> NDArray[np.uint8]:
        """Make the layout of a message the known one, and return its only row."""
        layout = _layout(self._type, message)
        groups = [(*layout.doubles[name], width) for name, width in self._groups.items()]
        expected = sum(self._groups.values())
        if (count := sum(min(count, width) for _, count, width in groups)) != expected:
            raise MessageError(f"a message has {count} numbers, expected {expected}")
        parts = [(at, at + width * _DOUBLE.itemsize) for at, _, width in groups]
        self._numbers = _places((_ORIGIN, _AFTER_STAMP), *parts)
        self._fixed = _places((-_LENGTH.size, 0), *layout.fixed)
        row = np.frombuffer(packed([message]), np.uint8)
        self._size, self._same = len(row), row[self._fixed]
        return row[None]


def _places(*ranges: tuple[int, int]) -> Rows:
    """Return the indices of some byte ranges of a message when its length is before it."""
    return _LENGTH.size + np.concatenate([np.arange(*ends) for ends in ranges])
