# SPDX-License-Identifier: Apache-2.0
"""Messages as CDR bytes: numbers are read and written in place, everything else is constant.

With five messages per tick and finger, generated (de)serialization is the largest cost of a node.
In a tick message only the timestamp and the numbers change. So a `CdrTemplate` keeps the rest, and
a `ContentReader` parses the rest only when it changes. Padding is written as zeros, so equal
numbers give equal bytes. Timestamps are in nanoseconds.

Unless a codec allows it, a number must be finite and at most `LARGEST_NUMBER`, and a quaternion of
unit length. Otherwise, and for bytes of another type or a wrong frame, each `decode` raises
MessageError. Each `encode` raises UnsafeOutputError for a number that may not be sent.

Source: OMG DDS-XTypes 1.3, 7.4 (plain CDR version 1); REP 2000 types of ROS 2 Jazzy.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray

from tactile_hand_ros.cdr import ENCODING, CdrTemplate, Content, ContentReader
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.explanation import did_you_mean
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.errors import MessageError, UnsafeOutputError, nearest, shortened
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.names import PALM_FRAME, contact_frame

if TYPE_CHECKING:
    from tactile_hand_ros.ros.node import TactileNode

Force = tuple[float, float, float]

LARGEST_NUMBER = 1e9
"""Largest magnitude that a message may carry, in SI units; larger numbers overflow in products."""

_LARGEST_SQUARE = LARGEST_NUMBER * LARGEST_NUMBER
_LONGEST_NAME = 80  # of a sender's text in an error
_UNIT_TOLERANCE = 1e-3
_NUMBER_SIZE = 12  # the encapsulation and a double


class Pose(NamedTuple):
    """A pose in the palm frame, or the contact frames C_i there, a row per finger.

    Attributes:
        position: Position [m]. Shape (3,) or (k, 3).
        quaternion: Orientation, order x, y, z, w. Shape (4,) or (k, 4).
    """

    position: Array
    quaternion: Array


def all_usable(values: Array) -> bool:
    """Return whether a contiguous array holds only numbers up to `LARGEST_NUMBER`."""
    flat = values.ravel()
    # One dot product is faster than two comparisons; a large sum only costs the second check.
    return bool(flat.dot(flat) <= _LARGEST_SQUARE or (np.abs(flat) <= LARGEST_NUMBER).all())


def check_output(values: Array, *, nan_allowed: bool = False) -> None:
    """Check numbers before they are published, so that receivers can use them.

    Raises:
        UnsafeOutputError: If one exceeds `LARGEST_NUMBER`, or is NaN where NaN is not allowed.
    """
    if all_usable(values) or (nan_allowed and all_usable(values[~np.isnan(values)])):
        return
    raise UnsafeOutputError(
        f"the result {np.array2string(values.ravel(), threshold=12, precision=3)} is not finite "
        "and was not published; reset the node and check its inputs and gains."
    )


def read_number(data: bytes) -> float:
    """Return the number of a serialized std_msgs/Float64; it raises as each `decode`."""
    if len(data) < _NUMBER_SIZE or data[:2] != ENCODING:
        raise MessageError(f"{len(data)} bytes that are not a std_msgs/msg/Float64.")
    (number,) = struct.unpack_from("<d", data, 4)
    if not _is_usable(number):
        raise MessageError(f"data is {number}, expected a finite number up to {LARGEST_NUMBER:g}.")
    return float(number)


def _is_usable(*numbers: float) -> bool:
    return all(-LARGEST_NUMBER <= number <= LARGEST_NUMBER for number in numbers)


def _checked_quaternion(quaternion: Sequence[float], what: str) -> None:
    x, y, z, w = quaternion
    if not abs(x * x + y * y + z * z + w * w - 1.0) < _UNIT_TOLERANCE:
        raise MessageError(
            f"{what} has the quaternion ({x}, {y}, {z}, {w}), expected a unit quaternion."
        )


def _checked_vector(vector: Sequence[float], what: str) -> None:
    if not _is_usable(*vector):
        raise MessageError(
            f"{what} is ({', '.join(map(str, vector))}), expected three finite numbers up to "
            f"{LARGEST_NUMBER:g}."
        )


def _check_frame(content: Content, frame: str) -> None:
    given = content.texts[0]
    if given != frame:
        raise MessageError(
            f"frame_id is '{shortened(given, _LONGEST_NAME)}', expected '{frame}'; transform it "
            "first."
        )


class WrenchCodec:
    """geometry_msgs/WrenchStamped with a force [N] and no torque."""

    def __init__(
        self,
        frame: str,
        *,
        nan_allowed: bool = False,
        any_frame: bool = False,
        normal_allowed: bool = False,
    ) -> None:
        """Create the codec for messages in a frame.

        Args:
            frame: The frame.
            nan_allowed: Whether NaN is valid, for "no value".
            any_frame: Whether read messages may be in any frame, if only y is used.
            normal_allowed: Whether x and z may both be NaN, from a skin without them.
        """
        self._frame = None if any_frame else frame
        self._nan_allowed, self._normal_allowed = nan_allowed, normal_allowed
        self._template = CdrTemplate().text(frame).doubles(6)
        self._force = self._template.finish()[0][:3]
        self._read = ContentReader("geometry_msgs/msg/WrenchStamped")

    def encode(self, force: Sequence[float] | Array, stamp_ns: int) -> bytes:
        """Return the message for a force of shape (3,)."""
        self._force[:] = force
        x, y, z = force
        if not x * x + y * y + z * z <= _LARGEST_SQUARE:
            known = self._force[1:2] if self._is_normal(x, z) else self._force
            check_output(known, nan_allowed=self._nan_allowed)
        return self._template.stamped(stamp_ns)

    def _is_normal(self, x: float, z: float) -> bool:
        return self._normal_allowed and math.isnan(x) and math.isnan(z)

    def decode(self, data: bytes) -> tuple[int, Force]:
        """Return timestamp and force [N]."""
        content = self._read(data)
        if self._frame is not None:
            _check_frame(content, self._frame)
        x, y, z = content.doubles["wrench"][:3].tolist()
        if not x * x + y * y + z * z <= _LARGEST_SQUARE:
            if self._nan_allowed and any(map(math.isnan, (x, y, z))):
                return content.stamp, (math.nan,) * 3
            is_known = self._is_normal(x, z) and not math.isnan(y)
            known = (0.0, y, 0.0) if is_known else (x, y, z)
            _checked_vector(known, "force")
        return content.stamp, (x, y, z)

    def decode_normal(self, data: bytes) -> tuple[int, float]:
        """Return timestamp and normal force [N], which carries k_f."""
        stamp, force = self.decode(data)
        return stamp, force[1]


class WrenchPublishers:
    """Publishes one vector per finger, in its contact frame, as the force of a WrenchStamped."""

    def __init__(
        self,
        node: TactileNode[Any],
        fingers: Sequence[str],
        topic: Callable[[str], str],
        **allowed: bool,
    ) -> None:
        """Create the publishers; `topic` maps a finger's name to its topic; see `WrenchCodec`."""
        codecs = {name: WrenchCodec(contact_frame(name), **allowed) for name in fingers}
        self._publishers = [
            node.tick_publisher(WrenchStamped, topic(name), codec.encode)
            for name, codec in codecs.items()
        ]

    def publish(self, stamp_ns: int, forces: Array) -> None:
        """Publish the vectors of a tick [ns], shape (k, 3)."""
        for publisher, force in zip(self._publishers, forces.tolist(), strict=True):
            publisher.publish(force, stamp_ns)


class PushCodec:
    """geometry_msgs/WrenchStamped with force [N] and torque [N m] on the object, palm axes."""

    def __init__(self) -> None:
        """Create the codec."""
        self._template = CdrTemplate().text(PALM_FRAME).doubles(6)
        self._wrench = self._template.finish()[0]
        self._read = ContentReader("geometry_msgs/msg/WrenchStamped")

    def encode(self, wrench: Array, stamp_ns: int) -> bytes:
        """Return the message for a wrench of shape (6,)."""
        self._wrench[:] = wrench
        check_output(self._wrench)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, Array]:
        """Return timestamp and wrench, shape (6,)."""
        content = self._read(data)
        _check_frame(content, PALM_FRAME)
        wrench = content.doubles["wrench"]
        _checked_vector(wrench[:3].tolist(), "the force")
        _checked_vector(wrench[3:].tolist(), "the torque")
        return content.stamp, wrench


class ContactsCodec:
    """geometry_msgs/PoseArray with the contact frames C_i of k fingers in the palm frame."""

    def __init__(self, count: int) -> None:
        """Create the codec for k fingers."""
        self._count = count
        self._template = CdrTemplate().text(PALM_FRAME).length(count).doubles(7 * count)
        self._rows = self._template.finish()[0].reshape(count, 7)
        self._read = ContentReader("geometry_msgs/msg/PoseArray")

    def encode(self, positions: Array, quaternions: Array, stamp_ns: int) -> bytes:
        """Return the message for contact points [m] and quaternions; NaN rows mean no contact."""
        self._rows[:, :3], self._rows[:, 3:] = positions, quaternions
        check_output(self._rows, nan_allowed=True)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, Pose]:
        """Return timestamp and contacts; a NaN position means no contact and gives NaN rows."""
        content = self._read(data)
        _check_frame(content, PALM_FRAME)
        rows = content.doubles["poses"].reshape(-1, 7)
        if len(rows) != self._count:
            raise MessageError(
                f"{len(rows)} contacts, expected {self._count}, one per finger, NaN for no contact."
            )
        for index, (x, y, z, *quaternion) in enumerate(rows.tolist()):
            if x != x and y != y and z != z:
                rows[index] = math.nan
                continue
            if not _is_usable(x, y, z):
                raise MessageError(
                    f"contact {index} is at ({x}, {y}, {z}), expected numbers up to "
                    f"{LARGEST_NUMBER:g} or all NaN."
                )
            _checked_quaternion(quaternion, f"contact {index}")
        return content.stamp, Pose(rows[:, :3].copy(), rows[:, 3:].copy())

    def decode_contacts(self, data: bytes) -> tuple[int, Contacts]:
        """Return timestamp and contacts with rotation matrices."""
        stamp, poses = self.decode(data)
        return stamp, Contacts.from_poses(*poses)


class JointCodec:
    """sensor_msgs/JointState with some of its fields, arrays of shape (m,) in the hand's order.

    A read message may name the joints in any order, each exactly once.
    """

    def __init__(
        self,
        names: Sequence[str],
        fields: Sequence[str] = ("position", "velocity", "effort"),
        *,
        others: bool = False,
    ) -> None:
        """Create the codec; `fields` keep the order of the default.

        With `others`, a read message may contain other joints too, such as those of an arm.
        """
        self._names, self._others = list(names), others
        self._given: list[str] | None = None
        self._places = np.arange(0)
        self._wanted = tuple(fields)
        template = CdrTemplate().text("").length(len(names))
        for name in names:
            template.text(name)
        for field in ("position", "velocity", "effort"):
            count = len(names) if field in fields else 0
            template.length(count).doubles(count)
        self._template, self._blocks = template, template.finish()
        self._read = ContentReader("sensor_msgs/msg/JointState")

    def encode(self, stamp_ns: int, *values: NDArray[Any]) -> bytes:
        """Return the message with one array per field."""
        for block, numbers in zip(self._blocks, values, strict=True):
            block[:] = numbers
            check_output(block)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, list[Array]]:
        """Return timestamp and one array per field."""
        content = self._found(data)
        return content.stamp, [self._own(content, field) for field in self._wanted]

    def decode_joints(self, data: bytes) -> tuple[int, Joints]:
        """Return timestamp and a driver's joint state; only the effort may be missing."""
        content, effort = self._found(data), None
        theta, rates = self._own(content, "position"), self._own(content, "velocity")
        with suppress(MessageError):
            effort = self._own(content, "effort")
        return content.stamp, Joints(theta, rates, effort)

    def _found(self, data: bytes) -> Content:
        """Parse a message and locate the hand's joints in it."""
        content = self._read(data)
        given = content.texts[1:]
        if given != self._given:
            self._places, self._given = self._places_in(given), given
        return content

    def _own(self, content: Content, field: str) -> Array:
        """Return a field in the hand's order, shape (m,)."""
        values = content.doubles[field]
        if values.size != len(content.texts) - 1:
            raise MessageError(
                f"{field} has {values.size} values, expected {len(content.texts) - 1}, one per "
                "joint."
            )
        own = values[self._places]
        if not all_usable(own):
            index = int(np.flatnonzero(~(np.abs(own) <= LARGEST_NUMBER))[0])
            raise MessageError(
                f"{field} of joint '{self._names[index]}' is {own[index]}, expected a number up "
                f"to {LARGEST_NUMBER:g}."
            )
        return own

    def _places_in(self, given: Sequence[str]) -> NDArray[np.intp]:
        """Return the index of each joint of the hand among the sender's names."""
        others = [shortened(name, _LONGEST_NAME) for name in given if name not in self._names]
        if others and not self._others:
            raise MessageError(f"unknown joint '{others[0]}'{did_you_mean(others[0], self._names)}")
        for name in self._names:
            count = given.count(name)
            if count != 1:
                problem = f"appears {count} times" if count else "is missing"
                raise MessageError(
                    f"joint '{name}' {problem}, expected each of {len(self._names)} once"
                    f"{nearest(name, others)}"
                )
        return np.array([given.index(name) for name in self._names])


class PoseCodec:
    """geometry_msgs/PoseStamped in the palm frame."""

    def __init__(self, *, nan_allowed: bool = False) -> None:
        """Create the codec; `nan_allowed` permits a NaN position or quaternion, "keep this one"."""
        self._nan_allowed = nan_allowed
        self._template = CdrTemplate().text(PALM_FRAME).doubles(7)
        (self._row,) = self._template.finish()
        self._read = ContentReader("geometry_msgs/msg/PoseStamped")

    def encode(self, position: Array, quaternion: Array, stamp_ns: int) -> bytes:
        """Return the message for a position [m] and a quaternion (x, y, z, w)."""
        self._row[:3], self._row[3:] = position, quaternion
        check_output(self._row, nan_allowed=self._nan_allowed)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, Pose]:
        """Return timestamp and pose."""
        content = self._read(data)
        _check_frame(content, PALM_FRAME)
        pose = Pose(*np.split(content.doubles["pose"], [3]))
        position_is_kept, rotation_is_kept = (
            self._nan_allowed and bool(np.isnan(part).all()) for part in pose
        )
        if not position_is_kept:
            _checked_vector(pose.position.tolist(), "position")
        if not rotation_is_kept:
            _checked_quaternion(pose.quaternion.tolist(), "the pose")
        return content.stamp, pose


class ImuCodec:
    """sensor_msgs/Imu, used only for the orientation of the palm in the world."""

    def __init__(self) -> None:
        """Create the codec; angular velocity and acceleration are marked as unknown."""
        self._template = CdrTemplate().text(PALM_FRAME).doubles(37)
        (self._row,) = self._template.finish()
        self._read = ContentReader("sensor_msgs/msg/Imu")
        self._row[[16, 28]] = -1.0  # -1 in a covariance marks unmeasured values

    def encode(self, orientation: Array, stamp_ns: int) -> bytes:
        """Return the message for a quaternion (x, y, z, w)."""
        self._row[:4] = orientation
        check_output(self._row)
        return self._template.stamped(stamp_ns)

    def decode(self, data: bytes) -> tuple[int, Array]:
        """Return timestamp and quaternion, shape (4,)."""
        content = self._read(data)
        orientation = content.doubles["orientation"]
        if content.doubles["rates, accelerations and covariances"][0] == -1.0:
            raise MessageError(
                "orientation_covariance[0] is -1, which marks an imu without orientation; expected "
                "that of the palm in the world."
            )
        _checked_quaternion(orientation.tolist(), "the orientation")
        return content.stamp, orientation
