# SPDX-License-Identifier: Apache-2.0
"""Serialized messages of one topic to arrays, all at once.

A general decoder builds one Python object a message. The messages of a topic nearly always have
the same strings and lengths, so that every number sits at the same byte: one message is parsed for
its layout, and the rest is a table of bytes of which columns are read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.errors import BagError

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

_ORIGIN = 4  # the encapsulation header; alignment counts from behind it
_SECOND = 1_000_000_000


@dataclass
class Layout:
    """Where the parts of a message are.

    Attributes:
        little: Whether the numbers are little-endian.
        texts: All strings in order; the first is the header's frame_id.
        doubles: Offset and count of each group of doubles.
        fixed: Ranges of bytes that a message must share to have this layout.
    """

    little: bool
    texts: list[str] = field(default_factory=list)
    doubles: dict[str, tuple[int, int]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """Messages of one layout.

    Attributes:
        rows: Which messages of the topic these are, shape (n,).
        layout: Where the numbers are.
        matrix: The bytes, shape (n, length).
    """

    rows: Rows
    layout: Layout
    matrix: NDArray[np.uint8]

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Header stamps in ns, shape (n,)."""
        order = "<" if self.layout.little else ">"
        seconds = self._column(_ORIGIN, 4, f"{order}i4").astype(np.int64)[:, 0]
        rest = self._column(_ORIGIN + 4, 4, f"{order}u4").astype(np.int64)[:, 0]
        return np.asarray(seconds * _SECOND + rest, dtype=np.int64)

    def doubles(self, name: str) -> Array:
        """Return a group of doubles, shape (n, count)."""
        start, count = self.layout.doubles[name]
        order = "<f8" if self.layout.little else ">f8"
        return self._column(start, 8 * count, order).astype(np.float64)

    def _column(self, start: int, size: int, kind: str) -> NDArray[np.generic]:
        part = np.ascontiguousarray(self.matrix[:, start : start + size])
        return part.view(kind) if size else np.empty((len(part), 0))


class _Cursor:
    """Walks over one message and notes what it finds."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _ORIGIN or data[0] or data[1] > 1:
            raise ValueError(f"encoding {data[:2].hex() or 'missing'}, expected plain CDR")
        self._data, self._at = data, _ORIGIN
        self.layout = Layout(little=bool(data[1]), fixed=[(0, 2)])

    def header(self) -> None:
        self._skip(8)
        self.text()

    def text(self) -> None:
        size = self.length()
        raw = self._fix(size)
        self.layout.texts.append(raw.rstrip(b"\0").decode("utf-8", "replace"))

    def length(self) -> int:
        self._at += -(self._at - _ORIGIN) % 4
        number: int = struct.unpack("<I" if self.layout.little else ">I", self._fix(4))[0]
        return number

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


def _joint_state(cursor: _Cursor) -> None:
    cursor.header()
    for _ in range(cursor.length()):
        cursor.text()
    for name in ("position", "velocity", "effort"):
        cursor.doubles(name, cursor.length())


def _pose_array(cursor: _Cursor) -> None:
    cursor.header()
    cursor.doubles("poses", 7 * cursor.length())


def _pose(cursor: _Cursor) -> None:
    cursor.header()
    cursor.doubles("pose", 7)


def _wrench(cursor: _Cursor) -> None:
    cursor.header()
    cursor.doubles("wrench", 6)


PARSERS: dict[str, Callable[[_Cursor], None]] = {
    "sensor_msgs/msg/JointState": _joint_state,
    "geometry_msgs/msg/PoseArray": _pose_array,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/WrenchStamped": _wrench,
}
"""The types that can be read, by name."""


def tables(type_name: str, messages: Sequence[bytes]) -> Iterator[Table]:
    """Group the messages of a topic by layout.

    Args:
        type_name: One of `PARSERS`.
        messages: Serialized messages.

    Raises:
        BagError: If a message is not what its type says.
    """
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        joined = b"".join([messages[row] for row in rows.tolist()])
        matrix = np.frombuffer(joined, dtype=np.uint8).reshape(len(rows), int(size))
        while len(rows):
            layout = _layout(type_name, messages[int(rows[0])])
            same = _sharing(matrix, layout)
            yield Table(rows[same], layout, matrix[same])
            rows, matrix = rows[~same], matrix[~same]


def _layout(type_name: str, message: bytes) -> Layout:
    try:
        cursor = _Cursor(message)
        PARSERS[type_name](cursor)
    except ValueError as error:
        raise BagError(f"A message is not a valid {type_name}: {error}; record it again.") from None
    return cursor.layout


def _sharing(matrix: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    """Return which messages have the fixed bytes of the first one."""
    same = np.ones(len(matrix), dtype=np.bool_)
    for start, end in layout.fixed:
        same &= (matrix[:, start:end] == matrix[0, start:end]).all(axis=1)
    return same
