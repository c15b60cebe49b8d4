# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays: pure functions that check what they read; `wire` writes.

Every ``..._from_ros`` function raises `MessageError` with one sentence when the content cannot be
used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseArray, PoseStamped, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState, JoyFeedback, JoyFeedbackArray
from std_msgs.msg import Float64

from tactile_hand_ros.cdr import to_nanoseconds
from tactile_hand_ros.config.explanation import did_you_mean
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.names import PALM_FRAME
from tactile_hand_ros.rotations import rotation_from_quaternion

Array = NDArray[np.float64]
LARGEST_NUMBER = 1e9
"""Largest magnitude that a message may carry, in SI units: larger ones overflow in products."""

_SECOND = 1_000_000_000
LARGEST_SQUARE = LARGEST_NUMBER * LARGEST_NUMBER
_LONGEST_NAME = 80  # characters of a sender's text that an error repeats
_UNIT_TOLERANCE = 1e-3
_NAN3 = (math.nan,) * 3
_NAN4 = (math.nan,) * 4


class ContactPoses(NamedTuple):
    """Contact frames C_i in the palm frame; NaN rows where a finger has no contact.

    Attributes:
        positions: Contact points [m]. Shape (k, 3).
        quaternions: Orientation of C_i, order x, y, z, w. Shape (k, 4).
    """

    positions: Array
    quaternions: Array


class TargetPose(NamedTuple):
    """A pose in the palm frame.

    Attributes:
        position: Position [m]. Shape (3,).
        rotation: Rotation matrix. Shape (3, 3).
    """

    position: Array
    rotation: Array


def stamp_to_ns(stamp: Time) -> int:
    """Return a message stamp as integer nanoseconds.

    Raises:
        MessageError: If it is not a time that a message can carry.
    """
    return to_nanoseconds(int(stamp.sec), int(stamp.nanosec))


def stamp_from_ns(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a message stamp."""
    seconds, rest = divmod(nanoseconds, _SECOND)
    return Time(sec=seconds, nanosec=rest)


def all_usable(values: Array) -> bool:
    """Return whether a contiguous array holds only numbers up to `LARGEST_NUMBER`."""
    flat = values.ravel()
    # One dot product is faster than two comparisons; a large sum only costs the second look.
    return bool(flat.dot(flat) <= LARGEST_SQUARE or (np.abs(flat) <= LARGEST_NUMBER).all())


def is_usable(number: float) -> bool:
    """Return whether a number is finite and at most `LARGEST_NUMBER`."""
    return -LARGEST_NUMBER <= number <= LARGEST_NUMBER


def shown(text: str) -> str:
    """Return a sender's text as an error repeats it: never longer than a line."""
    return text if len(text) <= _LONGEST_NAME else f"{text[:_LONGEST_NAME]}..."


class JointOrder:
    """Reads JointState messages in the hand's own order of joints.

    A message may name the joints in any order; each must be there once.
    """

    def __init__(self, names: Sequence[str], *, others: bool = False) -> None:
        """Take the joint names in the hand's order.

        Args:
            names: The names.
            others: Whether a message may have other joints too, such as those of an arm.
        """
        self.names = list(names)
        self._others = others
        self._given: list[str] | None = None
        self._places = np.arange(0)

    def read(self, message: JointState, field: str) -> Array:
        """Return ``position``, ``velocity`` or ``effort`` in the hand's order.

        Shape (m,).

        Raises:
            MessageError: For unknown, missing or repeated joints, wrong length, NaN or infinity.
        """
        if self._given is None or message.name != self._given:
            self._places = self._places_in(message.name)
            self._given = list(message.name)
        values = np.asarray(getattr(message, field), dtype=np.float64)
        if values.size != len(self._given):
            raise MessageError(
                f"{field} has {values.size} values, expected {len(self._given)}, one per joint."
            )
        own = values[self._places]
        if not all_usable(own):
            index = int(np.flatnonzero(~(np.abs(own) <= LARGEST_NUMBER))[0])
            raise MessageError(
                f"{field} of joint '{self.names[index]}' is {own[index]}, expected a number up to "
                f"{LARGEST_NUMBER:g}."
            )
        return own

    def _places_in(self, given: Sequence[str]) -> NDArray[np.intp]:
        """Return where each joint of the hand is among the names that a sender gives."""
        unknown = next((shown(name) for name in given if name not in self.names), None)
        if unknown is not None and not self._others:
            raise MessageError(f"unknown joint '{unknown}'{did_you_mean(unknown, self.names)}")
        for name in self.names:
            count = given.count(name)
            if count != 1:
                problem = f"is there {count} times" if count else "is missing"
                raise MessageError(
                    f"joint '{name}' {problem}, expected each of {len(self.names)} once."
                )
        return np.array([given.index(name) for name in self.names])


def contacts_from_ros(message: PoseArray, count: int, *, frame: str = PALM_FRAME) -> ContactPoses:
    """Read contact frames; a NaN position means no contact and gives NaN rows.

    Args:
        message: The message.
        count: Number of fingers k.
        frame: The frame the message must be in.

    Raises:
        MessageError: For a wrong frame or length, infinity or a quaternion not of unit length.
    """
    check_frame(message, frame)
    if len(message.poses) != count:
        raise MessageError(
            f"{len(message.poses)} contacts, expected {count}, one per finger, NaN for no contact."
        )
    positions, quaternions = [], []
    for index, pose in enumerate(message.poses):
        position, quaternion = _read_contact(pose, index)
        positions.append(position)
        quaternions.append(quaternion)
    return ContactPoses(np.array(positions).reshape(-1, 3), np.array(quaternions).reshape(-1, 4))


def _read_contact(pose: Pose, index: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    point = pose.position
    x, y, z = point.x, point.y, point.z
    if x != x and y != y and z != z:
        return _NAN3, _NAN4
    if not (is_usable(x) and is_usable(y) and is_usable(z)):
        raise MessageError(
            f"contact {index} is at ({x}, {y}, {z}), expected numbers up to {LARGEST_NUMBER:g} or "
            "all NaN."
        )
    return (x, y, z), _read_quaternion(pose, f"contact {index}")


def _read_quaternion(pose: Pose, what: str) -> tuple[float, ...]:
    turn = pose.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    square = x * x + y * y + z * z + w * w
    if not abs(square - 1.0) < _UNIT_TOLERANCE:
        raise MessageError(
            f"{what} has the quaternion ({x}, {y}, {z}, {w}), expected one of length 1."
        )
    return x, y, z, w


def check_frame(message: PoseArray | PoseStamped | WrenchStamped, frame: str) -> None:
    """Check the frame of a message.

    Raises:
        MessageError: If it is another one.
    """
    if message.header.frame_id != frame:
        raise MessageError(
            f"frame_id is '{shown(message.header.frame_id)}', expected '{frame}'; transform it "
            "first."
        )


def force_from_ros(message: WrenchStamped, *, frame: str | None = None) -> Array:
    """Read a force [N]. Shape (3,).

    Args:
        message: The message.
        frame: The frame the message must be in; None accepts any.

    Raises:
        MessageError: For NaN, infinity, a number beyond `LARGEST_NUMBER` or a wrong frame.
    """
    if frame is not None:
        check_frame(message, frame)
    vector = message.wrench.force
    return _vector(vector.x, vector.y, vector.z, "force")


def _vector(x: float, y: float, z: float, what: str) -> Array:
    if not (is_usable(x) and is_usable(y) and is_usable(z)):
        raise MessageError(
            f"{what} is ({x}, {y}, {z}), expected three finite numbers up to {LARGEST_NUMBER:g}."
        )
    return np.array((x, y, z), dtype=np.float64)


def number_from_ros(message: Float64) -> float:
    """Read a Float64 message.

    Raises:
        MessageError: For NaN, infinity or a number beyond `LARGEST_NUMBER`.
    """
    if not is_usable(message.data):
        raise MessageError(
            f"data is {message.data}, expected a finite number up to {LARGEST_NUMBER:g}."
        )
    return float(message.data)


def pose_from_ros(message: PoseStamped, *, frame: str = PALM_FRAME) -> TargetPose:
    """Read a pose.

    Raises:
        MessageError: For a wrong frame, NaN, infinity or a quaternion not of unit length.
    """
    check_frame(message, frame)
    point = message.pose.position
    position = _vector(point.x, point.y, point.z, "position")
    quaternion = _read_quaternion(message.pose, "the pose")
    return TargetPose(position, rotation_from_quaternion(quaternion))


def feedback_to_ros(
    intensities: Sequence[float], *, out: JoyFeedbackArray | None = None
) -> JoyFeedbackArray:
    """Fill a JoyFeedbackArray with rumble intensities, cut to the range 0 to 1."""
    if out is None or len(out.array) != len(intensities):
        rumble = JoyFeedback.TYPE_RUMBLE
        out = JoyFeedbackArray(
            array=[JoyFeedback(type=rumble, id=index) for index in range(len(intensities))]
        )
    for item, intensity in zip(out.array, intensities, strict=True):
        item.intensity = min(1.0, max(0.0, float(intensity)))
    return out
