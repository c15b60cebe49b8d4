# SPDX-License-Identifier: Apache-2.0
"""What is shown of a hand: transforms from the palm, and markers in the frame of the palm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import Point, TransformStamped
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.ros.messages import stamp_from_ns
from tactile_hand_ros.rotations import quaternion_from_rotation

Array = NDArray[np.float64]
Color = tuple[float, float, float, float]

_FINGERS: tuple[Color, ...] = (
    (0.0, 0.45, 0.70, 1.0),
    (0.84, 0.37, 0.0, 1.0),
    (0.0, 0.62, 0.45, 1.0),
    (0.80, 0.47, 0.65, 1.0),
)
_OBJECT: Color = (0.56, 0.65, 0.75, 0.4)
_GOAL: Color = (0.76, 0.09, 0.36, 1.0)
_LONGEST = 0.12  # m, of the strongest force
_AROUND = np.linspace(0.0, 2.0 * np.pi, 25)
_STEEPEST = 2.5  # friction above which a cone is drawn no wider

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


def frame_prefix(namespace: str) -> str:
    """Return the prefix of the frames of a hand, so that two hands can use one `/tf`."""
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


@dataclass(frozen=True)
class Scene:
    """What is to be drawn; NaN where something is not known.

    Attributes:
        corners: Corners of the object's faces, triangles in its own frame, shape (3 t, 3), m.
        object: Where the object is, None if that is not known.
        contacts: Contact frames by finger, in the order of the forces.
        forces: Forces on the object in the contact frames, shape (k, 3), N.
        friction: Learned friction, shape (k,).
        goal: The desired pose, None before the first.
        prefix: Prefix of the names of the hand's frames.
    """

    corners: Array
    object: Frame | None
    contacts: Sequence[Frame]
    forces: Array
    friction: Array
    goal: Frame | None
    prefix: str = ""


def markers(scene: Scene) -> MarkerArray:
    """Return everything that is known, after a marker that removes what was drawn before."""
    made = [_marker("all", 0, Marker.DELETEALL)]
    if scene.object is not None and scene.object.is_known and len(scene.corners):
        made.append(_placed(_triangles("object", 0, scene.corners, _OBJECT), scene.object))
    strongest = float(np.nanmax(np.linalg.norm(scene.forces, axis=1), initial=1e-9))
    for i, contact in enumerate(scene.contacts):
        if contact.is_known:
            made += _contact(i, contact, scene.forces[i] * _LONGEST / strongest, scene.friction[i])
    if scene.goal is not None and scene.goal.is_known:
        made.append(_placed(_axes(), scene.goal))
    for marker in made:
        marker.header.frame_id = scene.prefix + names.PALM_FRAME  # no stamp: where it is now
    return MarkerArray(markers=made)


def _contact(i: int, contact: Frame, force: Array, friction: float) -> list[Marker]:
    """Return point, arrow and cone of a contact; force as a length, in its frame, m."""
    color = _FINGERS[i % len(_FINGERS)]
    dot = _marker("contacts", i, Marker.ADD, Marker.SPHERE, color)
    dot.scale.x = dot.scale.y = dot.scale.z = 0.008
    made = [_placed(dot, contact)]
    if not np.isfinite(force).all() or not np.linalg.norm(force) > 0.0:
        return made
    arrow = _marker("forces", i, Marker.ADD, Marker.ARROW, (0.1, 0.14, 0.19, 1.0))
    arrow.points = _points([np.zeros(3), force])
    arrow.scale.x, arrow.scale.y = 0.004, 0.009
    made.append(_placed(arrow, contact))
    if np.isfinite(friction) and force[1] > 0.0:
        made.append(_placed(_cone(i, float(force[1]), float(friction), color), contact))
    return made


def _cone(i: int, height: float, friction: float, color: Color) -> Marker:
    """Return the friction cone, as high as the normal force is long; its axis is y, the normal."""
    radius = height * min(friction, _STEEPEST)
    rim = np.stack(
        [radius * np.cos(_AROUND), np.full(len(_AROUND), height), radius * np.sin(_AROUND)], axis=1
    )
    corners = [part for a, b in zip(rim, rim[1:], strict=False) for part in (np.zeros(3), a, b)]
    return _triangles("cones", i, np.array(corners), (*color[:3], 0.25))


def _triangles(namespace: str, number: int, corners: Array, color: Color) -> Marker:
    marker = _marker(namespace, number, Marker.ADD, Marker.TRIANGLE_LIST, color)
    marker.points = _points(corners)
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def _axes() -> Marker:
    marker = _marker("goal", 0, Marker.ADD, Marker.LINE_LIST, _GOAL)
    marker.points = _points([end for axis in 0.05 * np.eye(3) for end in (np.zeros(3), axis)])
    marker.scale.x = 0.003
    return marker


def _marker(
    namespace: str, number: int, action: int, kind: int = 0, color: Color = _OBJECT
) -> Marker:
    marker = Marker(ns=namespace, id=number, action=action, type=kind)
    marker.pose.orientation.w = 1.0
    red, green, blue, alpha = map(float, color)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def _placed(marker: Marker, frame: Frame) -> Marker:
    at, turn = marker.pose.position, marker.pose.orientation
    at.x, at.y, at.z = map(float, frame.position)
    turn.x, turn.y, turn.z, turn.w = map(float, frame.quaternion)
    return marker


def _points(corners: Iterable[Array]) -> list[Point]:
    return [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in corners]
