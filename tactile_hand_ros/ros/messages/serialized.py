# SPDX-License-Identifier: Apache-2.0
"""Message objects as the bytes that go over the wire.

``rclpy.serialize_message`` may leave stray bytes behind a message and does not clear the gaps
between its fields. Here the bytes end where the message does, rounded up to four as in a packet,
and gaps are zero, so equal messages give equal bytes.

Source: OMG DDS-XTypes 1.3, 7.4 (plain CDR version 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.serialization import serialize_message

_SIZES = {
    **dict.fromkeys(("boolean", "octet", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float"), 4),
    **dict.fromkeys(("int64", "uint64", "double"), 8),
}
_LENGTH = 4
_ENCAPSULATION = 4


def serialized(message: Any) -> bytes:
    """Return a message as bytes."""
    walk = _Walk(bytearray(serialize_message(message)))
    walk.message(message)
    walk.align(_LENGTH)
    return bytes(walk.data[: _ENCAPSULATION + walk.at]).ljust(_ENCAPSULATION + walk.at, b"\0")


class _Walk:
    """Goes through the fields of a serialized message and clears the gaps between them.

    Attributes:
        data: The bytes, after the encapsulation.
        at: Where the walk is, counted from the end of the encapsulation.
    """

    def __init__(self, data: bytearray) -> None:
        self.data = data
        self.at = 0

    def align(self, size: int) -> None:
        gap = -self.at % size
        begin = _ENCAPSULATION + self.at
        self.data[begin : begin + gap] = bytes(gap)
        self.at += gap

    def message(self, message: Any) -> None:
        fields = message.get_fields_and_field_types()
        for name, kind in fields.items():
            self._field(getattr(message, name), kind)
        self.at += not fields  # a structure has at least one byte

    def _field(self, value: Any, kind: str) -> None:
        if kind in _SIZES:
            self._numbers(1, kind)
        elif kind.startswith("sequence<"):
            self._numbers(1, "uint32")
            self._items(value, kind.removeprefix("sequence<").removesuffix(">").partition(",")[0])
        elif kind.endswith("]"):
            self._items(value, kind[: kind.rindex("[")])
        elif kind.startswith("string"):
            self._numbers(1, "uint32")
            self.at += len(value.encode()) + 1
        elif kind.startswith("wstring"):
            self._numbers(1, "uint32")
            self.at += len(value.encode("utf-16-le"))
        else:
            self.message(value)

    def _items(self, values: Sequence[Any], kind: str) -> None:
        if kind in _SIZES:
            self._numbers(len(values), kind)
        else:
            for value in values:
                self._field(value, kind)

    def _numbers(self, count: int, kind: str) -> None:
        if count:
            self.align(_SIZES[kind])
            self.at += count * _SIZES[kind]
