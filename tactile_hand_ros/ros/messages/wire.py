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
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from tactile_hand_ros.cdr import CdrTemplate, header_stamp, to_nanoseconds
from tactile_hand_ros.errors import MessageError, UnsafeOutputError
from tactile_hand_ros.names import PALM_FRAME
from tactile_hand_ros.ros.messages import conversions
from tactile_hand_ros.ros.messages.conversions import (
    LARGEST_SQUARE,
    ContactPoses,
    JointOrder,
    all_usable,
    stamp_to_ns,
)

Array = NDArray[np.float64]
Force = tuple[float, float, float]

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
        if found is not None and all_usable(found[0]):
            rows = found[0].reshape(-1, 7)
            turns = rows[:, 3:].copy()
            if all(map(_is_unit, turns.tolist())):
                return header_stamp(data), ContactPoses(rows[:, :3].copy(), turns)
        message = read_message(data, PoseArray)
        contacts = conversions.contacts_from_ros(message, self._count)
        return stamp_to_ns(message.header.stamp), contacts


class JointCodec:
    """JointState with some of its fields, in the hand's order of joints."""

    def __init__(
        self,
        names: Sequence[str],
        fields: Sequence[str] = ("position", "velocity", "effort"),
        wanted: Sequence[str] = (),
        *,
        others: bool = False,
    ) -> None:
        """Fix the joints.

        Args:
            names: Joint names in the hand's order.
            fields: Which of ``position``, ``velocity`` and ``effort`` are written, in this order.
            wanted: The first of those fields, which are read; all by default.
            others: Whether a message that is read may have other joints too.
        """
        self._order = JointOrder(names, others=others)
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
        if not all_usable(self._template.fill(*values)):
            for block in values:
                check_output(block)
        return self._template.stamped(stamp_ns)

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
        if found is not None and all_usable(found[0]):
            values = found[1]
            return header_stamp(data), values[: len(self._wanted)], values[-1]
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
