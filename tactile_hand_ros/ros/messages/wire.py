# SPDX-License-Identifier: Apache-2.0
"""Tick messages as CDR bytes: numbers are read and written in place, everything else is constant.

Five messages a tick and finger make generated (de)serialization the largest cost of a node. In a
tick message only the stamp and the numbers change, so a `CdrTemplate` keeps the rest. Bytes that do
not fit the template (another order of joints, another frame, NaN, a big-endian sender) take the
ordinary way through rclpy and `conversions`, which also finds the words for what is wrong.
Written bytes have zeros for padding, so equal numbers give equal bytes.

Source: OMG DDS-XTypes 1.3, 7.4 (plain CDR version 1); REP 2000 types of ROS 2 Jazzy.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from tactile_hand_ros.errors import MessageError, UnsafeOutputError
from tactile_hand_ros.names import PALM_FRAME
from tactile_hand_ros.ros.messages import conversions
from tactile_hand_ros.ros.messages.conversions import (
    LARGEST_SQUARE,
    ContactPoses,
    JointOrder,
    all_usable,
    stamp_to_ns,
    to_nanoseconds,
)

Array = NDArray[np.float64]
Force = tuple[float, float, float]

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_STAMP_AT = len(_LITTLE_ENDIAN)
_AFTER_STAMP = _STAMP_AT + _STAMP.size
_LENGTH = struct.Struct("<I")
_DOUBLE = np.dtype("<f8")
_SECOND = 1_000_000_000
_UNIT_TOLERANCE = 1e-3

LARGEST_MESSAGE = 65_536
"""Largest message that is read [bytes]: a hand with a thousand joints needs less."""


def read_message(data: bytes, kind: Any) -> Any:
    """Deserialize a message that came from outside.

    Args:
        data: Serialized message.
        kind: Message class.

    Raises:
        MessageError: If the bytes are too many or are not a message of that class.
    """
    if len(data) > LARGEST_MESSAGE:
        raise MessageError(f"{len(data)} bytes, expected at most {LARGEST_MESSAGE}.")
    try:
        return deserialize_message(data, kind)
    except Exception:  # the errors of the middleware have no public class
        raise MessageError(
            f"{len(data)} bytes that are not a {kind.__name__}; send a serialized {kind.__name__}."
        ) from None


def check_output(values: Array, *, nan_allowed: bool = False) -> None:
    """Check numbers that are about to leave the node: what is sent can be read.

    Raises:
        UnsafeOutputError: If one is beyond `LARGEST_NUMBER`, or NaN where NaN is not an answer.
    """
    if all_usable(values) or (nan_allowed and all_usable(values[~np.isnan(values)])):
        return
    raise UnsafeOutputError(
        f"the result {np.array2string(values.ravel(), threshold=12, precision=3)} is not finite "
        "and was not published; reset the node and check its inputs and gains."
    )


class CdrTemplate:
    """The bytes of a message that begins with a stamp, with gaps for blocks of doubles."""

    def __init__(self) -> None:
        """Start with the encapsulation and the stamp."""
        self._buffer = bytearray(_LITTLE_ENDIAN + bytes(_STAMP.size))
        self._blocks: list[tuple[int, int]] = []
        self._constant: list[tuple[slice, bytes]] = []
        self._views: list[Array] = []
        self._parts: list[slice] = []
        self._at = 0
        self._all = np.empty(0)
        self._format = _STAMP

    def _align(self, size: int) -> None:
        # Alignment counts from the end of the encapsulation.
        self._buffer += bytes(-(len(self._buffer) - len(_LITTLE_ENDIAN)) % size)

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
        """Append a gap for doubles; none at all do not align, as CDR has it."""
        if count:
            self._align(_DOUBLE.itemsize)
            self._blocks.append((len(self._buffer), count))
            self._buffer += bytes(count * _DOUBLE.itemsize)
        return self

    def finish(self) -> CdrTemplate:
        """Note what is constant; nothing can be appended any more."""
        start = _AFTER_STAMP
        for offset, count in [*self._blocks, (len(self._buffer), 0)]:
            if offset > start:
                self._constant.append((slice(start, offset), bytes(self._buffer[start:offset])))
            start = offset + count * _DOUBLE.itemsize
        if self._blocks:
            self._note_numbers()
        return self

    def _note_numbers(self) -> None:
        """Note where all blocks can be read at once, with the lengths between them as numbers."""
        first = self._blocks[0][0]
        starts = [(at - first) // _DOUBLE.itemsize for at, _ in self._blocks]
        self._parts = [slice(at, at + n) for at, (_, n) in zip(starts, self._blocks, strict=True)]
        count = self._parts[-1].stop
        self._at = first
        self._all = np.frombuffer(self._buffer, _DOUBLE, count, first)
        self._views = [self._all[part] for part in self._parts]
        self._format = struct.Struct(f"<{_STAMP_AT}xiI{first - _AFTER_STAMP}x{count}d")

    def view(self, block: int) -> Array:
        """Return the numbers of a block, to be written in place before `stamped`."""
        return self._views[block]

    def stamped(self, stamp_ns: int) -> bytes:
        """Return the bytes with a stamp [ns] and the numbers that are in the blocks."""
        _STAMP.pack_into(self._buffer, _STAMP_AT, *divmod(stamp_ns, _SECOND))
        return bytes(self._buffer)

    def encode(self, stamp_ns: int, *values: NDArray[Any]) -> bytes:
        """Return the bytes with a stamp [ns] and one array per block, flat and of its size.

        Raises:
            UnsafeOutputError: If a number is not finite.
        """
        for view, block in zip(self._views, values, strict=True):
            view[:] = block
        if not all_usable(self._all):  # a length between two blocks is a tiny number
            for view in self._views:
                check_output(view)
        return self.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, list[Array]] | None:
        """Return stamp [ns] and blocks, None if a number or anything but the numbers is unusual.

        Raises:
            MessageError: If the stamp is not a time.
        """
        if not self._fits(data):
            return None
        numbers = np.frombuffer(data, _DOUBLE, len(self._all), self._at).copy()  # aligned, and kept
        if not all_usable(numbers):
            return None
        stamp = to_nanoseconds(*_STAMP.unpack_from(data, _STAMP_AT))
        return stamp, [numbers[part] for part in self._parts]

    def unpack(self, data: bytes) -> tuple[Any, ...] | None:
        """Return seconds, nanoseconds and the numbers, None if anything but them is unusual.

        For one short block this is faster than `decode`. The numbers may be of any size, or NaN.
        """
        return self._format.unpack_from(data) if self._fits(data) else None

    def _fits(self, data: bytes) -> bool:
        """Return whether bytes differ from the template in stamp and numbers only."""
        if len(data) != len(self._buffer) or data[:_STAMP_AT] != _LITTLE_ENDIAN:
            return False
        for where, expected in self._constant:
            if data[where] != expected:
                return False
        return True


class WrenchCodec:
    """WrenchStamped with a force [N] and no torque."""

    def __init__(self, frame: str, *, nan_allowed: bool = False, any_frame: bool = False) -> None:
        """Fix the frame.

        Args:
            frame: The frame that is written and that a read message must be in.
            nan_allowed: Whether NaN is an answer (there is none) instead of a mistake, in what is
                read and in what is written.
            any_frame: Whether a read message may be in any frame, as where only y counts.
        """
        self._frame = None if any_frame else frame
        self._nan_allowed = nan_allowed
        self._template = CdrTemplate().text(frame).doubles(6).finish()
        self._force = self._template.view(0)[:3]

    def encode(self, force: Sequence[float] | Array, stamp_ns: int) -> bytes:
        """Return the message for a force of shape (3,).

        Raises:
            UnsafeOutputError: If it is infinite, or NaN where that is not allowed.
        """
        self._force[:] = force
        x, y, z = force
        if not x * x + y * y + z * z <= LARGEST_SQUARE:
            check_output(self._force, nan_allowed=self._nan_allowed)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, Force]:
        """Return stamp [ns] and force.

        Raises:
            MessageError: For bytes of another type, a wrong frame, a number beyond
                `LARGEST_NUMBER`, or NaN where it is not allowed.
        """
        read = self._template.unpack(data)
        if read is not None:
            seconds, nanoseconds, x, y, z, *_ = read
            if x * x + y * y + z * z <= LARGEST_SQUARE:
                return to_nanoseconds(seconds, nanoseconds), (x, y, z)
        return self._read(data)

    def _read(self, data: bytes) -> tuple[int, Force]:
        """Read a message that is unusual, or say what is wrong with it."""
        message = read_message(data, WrenchStamped)
        vector = message.wrench.force
        if self._nan_allowed and any(map(math.isnan, (vector.x, vector.y, vector.z))):
            if self._frame is not None:
                conversions.check_frame(message, self._frame)
            return stamp_to_ns(message.header.stamp), (math.nan,) * 3
        x, y, z = conversions.force_from_ros(message, frame=self._frame).tolist()
        return stamp_to_ns(message.header.stamp), (x, y, z)


class ContactsCodec:
    """PoseArray with the contact frames C_i of k fingers in the palm frame."""

    def __init__(self, count: int) -> None:
        """Fix the number of fingers k."""
        self._count = count
        template = CdrTemplate().text(PALM_FRAME).length(count)
        self._template = template.doubles(7 * count).finish()
        self._rows = self._template.view(0).reshape(count, 7)

    def encode(self, positions: Array, quaternions: Array, stamp_ns: int) -> bytes:
        """Return the message; NaN rows where a finger has no contact.

        Args:
            positions: Contact points [m]. Shape (k, 3).
            quaternions: Contact frames, order x, y, z, w. Shape (k, 4).
            stamp_ns: The tick [ns].

        Raises:
            UnsafeOutputError: If a number is infinite.
        """
        self._rows[:, :3], self._rows[:, 3:] = positions, quaternions
        check_output(self._rows, nan_allowed=True)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, ContactPoses]:
        """Return stamp [ns] and contacts.

        Raises:
            MessageError: For bytes of another type, a wrong frame or length, infinity or a
                quaternion not of unit length.
        """
        found = self._template.decode(data)
        if found is not None:
            rows = found[1][0].reshape(-1, 7)
            turns = rows[:, 3:].copy()
            if all(map(_is_unit, turns.tolist())):
                return found[0], ContactPoses(rows[:, :3].copy(), turns)
        message = read_message(data, PoseArray)
        contacts = conversions.contacts_from_ros(message, self._count)
        return stamp_to_ns(message.header.stamp), contacts


class JointCodec:
    """JointState with some of its fields, in the hand's order of joints."""

    def __init__(
        self, names: Sequence[str], fields: Sequence[str], wanted: Sequence[str] = ()
    ) -> None:
        """Fix the joints.

        Args:
            names: Joint names in the hand's order.
            fields: Which of ``position``, ``velocity`` and ``effort`` are written, in this order.
            wanted: The first of those fields, which are read; all by default.
        """
        self._order = JointOrder(names)
        self._wanted = tuple(wanted or fields)
        template = CdrTemplate().text("").length(len(names))
        for name in names:
            template.text(name)
        for field in ("position", "velocity", "effort"):
            count = len(names) if field in fields else 0
            template.length(count).doubles(count)
        self._template = template.finish()

    def encode(self, stamp_ns: int, *values: NDArray[Any]) -> bytes:
        """Return the message with one array of shape (m,) per field.

        Raises:
            UnsafeOutputError: If a number is not finite.
        """
        return self._template.encode(stamp_ns, *values)

    def decode(self, data: bytes) -> tuple[int, list[Array]]:
        """Return stamp [ns] and one array of shape (m,) per wanted field.

        Raises:
            MessageError: For bytes of another type, unknown, missing or repeated joints, wrong
                length, NaN or infinity.
        """
        stamp, values, _ = self.decode_with_last(data)
        return stamp, values

    def decode_with_last(self, data: bytes) -> tuple[int, list[Array], Array | None]:
        """Return stamp [ns], one array of shape (m,) per wanted field, and a usable effort or None.

        Raises:
            MessageError: As `decode`.
        """
        found = self._template.decode(data)
        if found is not None:
            stamp, values = found
            return stamp, values[: len(self._wanted)], values[-1]
        message = read_message(data, JointState)
        stamp = stamp_to_ns(message.header.stamp)
        values = [self._order.read(message, field) for field in self._wanted]
        effort = None
        with suppress(MessageError):
            effort = self._order.read(message, "effort")
        return stamp, values, effort


def _is_unit(quaternion: Sequence[float]) -> bool:
    x, y, z, w = quaternion
    return abs(x * x + y * y + z * z + w * w - 1.0) < _UNIT_TOLERANCE


class PoseCodec:
    """PoseStamped, for writing."""

    def __init__(self, frame: str = PALM_FRAME) -> None:
        """Fix the frame."""
        self._template = CdrTemplate().text(frame).doubles(7).finish()
        self._row = self._template.view(0)

    def encode(self, position: Array, quaternion: Array, stamp_ns: int) -> bytes:
        """Return the message for a position [m] and a quaternion (x, y, z, w).

        Raises:
            UnsafeOutputError: If a number is not finite.
        """
        self._row[:3], self._row[3:] = position, quaternion
        check_output(self._row)
        return self._template.stamped(stamp_ns)


class SlipCodec(JointCodec):
    """JointState with the true sliding of the contacts by finger: distance [m], speed [m/s]."""

    def __init__(self, fingers: Sequence[str]) -> None:
        """Fix the fingers."""
        super().__init__(fingers, ("position", "velocity"))


class GripCodec(JointCodec):
    """JointState with what is known of each finger's grip: friction, evidence for slip, `Grip`."""

    def __init__(self, fingers: Sequence[str]) -> None:
        """Fix the fingers."""
        super().__init__(fingers, ("position", "velocity", "effort"))


def clock_bytes(stamp_ns: int) -> bytes:
    """Return a Clock message."""
    return _LITTLE_ENDIAN + _STAMP.pack(*divmod(stamp_ns, _SECOND))


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] of a serialized message that begins with a header.

    Raises:
        MessageError: If there is none, or it is not a time.
    """
    if len(data) < _AFTER_STAMP:
        raise MessageError(f"{len(data)} bytes, expected a message that begins with a stamp.")
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, _STAMP_AT)
    return to_nanoseconds(seconds, nanoseconds)
