# SPDX-License-Identifier: Apache-2.0
"""Where palm, links, contacts and object are, as transforms from the palm; without tf2."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.ros.messages.conversions import stamp_from_ns
from tactile_hand_ros.rotations import quaternion_from_rotation

Array = NDArray[np.float64]

OBJECT_FRAME = "object"


class Frame(NamedTuple):
    """A frame in the frame of the palm.

    Attributes:
        name: Name of the frame.
        position: Its origin, shape (3,), m.
        quaternion: Its orientation (x, y, z, w), shape (4,).
    """

    name: str
    position: Array
    quaternion: Array

    @property
    def is_known(self) -> bool:
        """Whether all numbers are finite."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.quaternion).all())


class LinkFrames:
    """The links of a hand by its URDF, of which the palm is the root.

    Attributes:
        joint_names: Joints in the order of `moving`.
    """

    def __init__(self, description: str) -> None:
        """Read a URDF that `Hand` has accepted."""
        self._model = pin.buildModelFromXML(description)
        self._data = self._model.createData()
        self.joint_names = list(self._model.names[1:])
        bodies = [
            (frame.name, number)
            for number, frame in enumerate(self._model.frames)
            if frame.type == pin.BODY
        ]
        root = min(bodies, key=lambda body: body[1])
        links = [body for body in bodies if body != root]
        self._fixed = [body for body in links if not self._model.frames[body[1]].parentJoint]
        self._moving = [body for body in links if self._model.frames[body[1]].parentJoint]

    def fixed(self) -> list[Frame]:
        """Return the links that do not move against the palm."""
        return self._at(np.zeros(self._model.nq), self._fixed)

    def moving(self, theta: Array) -> list[Frame]:
        """Return the links that joints move, at joint angles of shape (m,), rad."""
        return self._at(theta, self._moving)

    def _at(self, theta: Array, links: list[tuple[str, int]]) -> list[Frame]:
        pin.framesForwardKinematics(self._model, self._data, theta)
        places = [(name, self._data.oMf[number]) for name, number in links]
        return [
            Frame(name, place.translation.copy(), quaternion_from_rotation(place.rotation))
            for name, place in places
        ]


def contact_frames(fingers: list[str], positions: Array, quaternions: Array) -> list[Frame]:
    """Return the contact frames C_i of the fingers that touch."""
    found = zip(fingers, positions, quaternions, strict=True)
    frames = [Frame(names.contact_frame(finger), *pose) for finger, *pose in found]
    return [frame for frame in frames if frame.is_known]


def frame_prefix(namespace: str) -> str:
    """Return what the frames of a hand begin with, so that two hands can share `/tf`."""
    return f"{namespace.strip('/')}/" if namespace.strip("/") else ""


def transforms(frames: list[Frame], stamp_ns: int, prefix: str = "") -> list[TransformStamped]:
    """Return the transforms from the palm to frames, with a stamp and prefixed names."""
    made = []
    for frame in frames:
        message = TransformStamped(child_frame_id=prefix + frame.name)
        message.header.frame_id = prefix + names.PALM_FRAME
        message.header.stamp = stamp_from_ns(stamp_ns)
        move, turn = message.transform.translation, message.transform.rotation
        move.x, move.y, move.z = map(float, frame.position)
        turn.x, turn.y, turn.z, turn.w = map(float, frame.quaternion)
        made.append(message)
    return made
