# SPDX-License-Identifier: Apache-2.0
"""The viewer: transforms and markers for RViz, Foxglove and PlotJuggler, a few times a second.

For each frame it takes the newest message of each topic, so it is cheap at any tick rate. No other
node depends on it. The links of the hand come from robot_state_publisher. Without tf2_msgs there
are no transforms; the markers need none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Point, PoseArray, PoseStamped, TransformStamped, WrenchStamped
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest
from tactile_hand_ros.ros.messages import ContactsCodec, PoseCodec, WrenchCodec, stamp_from_ns
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.simulation.plant_config import ObjectConfig

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the pip wheels, but part of every full installation
    TFMessage = None

Color = tuple[float, float, float, float]

MARKERS = "markers"
_FINGERS: tuple[Color, ...] = (
    (0.0, 0.45, 0.70, 1.0),
    (0.84, 0.37, 0.0, 1.0),
    (0.0, 0.62, 0.45, 1.0),
    (0.80, 0.47, 0.65, 1.0),
)
_OBJECT: Color = (0.56, 0.65, 0.75, 0.4)
_GOAL: Color = (0.76, 0.09, 0.36, 1.0)
_FORCE: Color = (0.1, 0.14, 0.19, 1.0)
_LONGEST = 0.12  # m, of the strongest force


class ViewerConfig(Config):
    """Configuration of the viewer."""

    hand: str = param("paper", "hand by name or YAML file")
    rate: float = param(30.0, "pictures per second", unit="Hz", gt=0.0, le=100.0)
    object: ObjectConfig = ObjectConfig()


class Frame(NamedTuple):
    """A coordinate frame in the palm frame: name, origin [m], orientation (x, y, z, w)."""

    name: str
    position: Array
    quaternion: Array


class ViewerNode(TactileNode[ViewerConfig]):
    """Publishes transforms and markers.

    Subscriptions, newest message only: `tactile/contacts`, `tactile/<finger>/wrench`,
    `accepted/desired_pose`, `ground_truth/object_pose`.

    Publications: `markers` (visualization_msgs/MarkerArray in `palm`, only while there is a
    subscriber), `/tf` (tf2_msgs/TFMessage, if installed: from `palm` to contacts and object). In a
    namespace, frame names are prefixed with it, as in `left/palm`, because all hands share `/tf`.

    Parameters: the fields of `ViewerConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Subscribe and create the publishers.

        Raises:
            TactileHandError: If a parameter is rejected or there is no such hand.
        """
        super().__init__("viewer", ViewerConfig, **kwargs)
        self._fingers = load_hand_config(self.config.hand).finger_names
        self._corners = self.config.object.solid().triangles().reshape(-1, 3)
        namespace = self.get_namespace().strip("/")
        self._prefix = f"{namespace}/" if namespace else ""
        self._taken: dict[str, Any] = {}
        pose = PoseCodec().decode
        self._listening: dict[str, tuple[Subscription, Callable[[bytes], Any]]] = {}
        self._listen(names.CONTACTS, PoseArray, ContactsCodec(len(self._fingers)).decode)
        self._listen(names.ACCEPTED_POSE, PoseStamped, pose)
        self._listen(names.OBJECT_POSE, PoseStamped, pose)
        for finger in self._fingers:
            codec = WrenchCodec(names.contact_frame(finger), any_frame=True, normal_allowed=True)
            self._listen(names.wrench(finger), WrenchStamped, codec.decode)
        self._markers = self.create_publisher(MarkerArray, MARKERS, qos.user_qos())
        self._tf: Any = None
        if TFMessage is None:
            self.diagnostics.value("tf", "tf2_msgs is not installed")
        else:
            self._tf = self.create_publisher(TFMessage, "/tf", qos.user_qos())
        self.create_timer(1.0 / self.config.rate, self.show)

    def _listen(self, topic: str, kind: Any, decode: Callable[[bytes], Any]) -> None:
        """Subscribe to publishers of any reliability, unless the user overrides it."""
        profile = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        options = QoSOverridingOptions.with_default_policies()
        own = subscribe_directly(self, kind, topic, profile, qos_overriding_options=options)
        self._listening[topic] = own, decode

    def show(self) -> None:
        """Publish transforms and markers of the newest messages."""
        for topic, (subscription, decode) in self._listening.items():
            data = take_latest(subscription)
            if data is not None:
                self._taken.pop(topic, None)
                with suppress(MessageError):  # the controllers reject and report it
                    self._taken[topic] = decode(data)
        contacts, where = self._contacts(), self._pose(names.OBJECT_POSE, "object")
        if self._tf is not None and names.CONTACTS in self._taken:
            stamp, _ = self._taken[names.CONTACTS]
            known = [frame for frame in (*contacts, where) if frame is not None]
            self._tf.publish(TFMessage(transforms=transforms(known, stamp, self._prefix)))
        if self._markers.get_subscription_count():
            goal = self._pose(names.ACCEPTED_POSE, "goal")
            made = [_marker("all", 0, Marker.DELETEALL)]
            if where is not None and len(self._corners):
                made.append(_placed(_body(self._corners), where))
            made += contact_markers(contacts, self._forces())
            if goal is not None:
                made.append(_placed(_axes(), goal))
            for marker in made:  # no timestamp: the current position
                marker.header.frame_id = self._prefix + names.PALM_FRAME
            self._markers.publish(MarkerArray(markers=made))
        self.diagnostics.tick()

    def _contacts(self) -> list[Frame | None]:
        """Return the contact of each finger, or None without contact."""
        if names.CONTACTS not in self._taken:
            return [None] * len(self._fingers)
        _, (positions, quaternions) = self._taken[names.CONTACTS]
        places = zip(self._fingers, positions, quaternions, strict=True)
        return [_known(names.contact_frame(finger), *place) for finger, *place in places]

    def _forces(self) -> Array:
        forces = np.full((len(self._fingers), 3), np.nan)
        for i, finger in enumerate(self._fingers):
            if names.wrench(finger) in self._taken:
                _, forces[i] = self._taken[names.wrench(finger)]
        return known_part(forces)

    def _pose(self, topic: str, name: str) -> Frame | None:
        return _known(name, *self._taken[topic][1]) if topic in self._taken else None


def _known(name: str, position: Array, quaternion: Array) -> Frame | None:
    """Return a frame, or None if its pose is unknown."""
    is_known = np.isfinite(position).all() and np.isfinite(quaternion).all()
    return Frame(name, position, quaternion) if is_known else None


def transforms(frames: Sequence[Frame], stamp_ns: int, prefix: str = "") -> list[TransformStamped]:
    """Return the transforms from the palm to frames, with a timestamp and prefixed names."""
    made = []
    for frame in frames:
        message = TransformStamped(child_frame_id=prefix + frame.name)
        message.header.frame_id = prefix + names.PALM_FRAME
        message.header.stamp = stamp_from_ns(stamp_ns)
        _place(message.transform.translation, message.transform.rotation, frame)
        made.append(message)
    return made


def contact_markers(contacts: Sequence[Frame | None], forces: Array) -> list[Marker]:
    """Return markers of known contact points and forces on the object, shape (k, 3), N."""
    lengths = np.linalg.norm(forces, axis=1)
    scale = _LONGEST / float(np.nanmax(lengths, initial=1e-9))
    made = []
    for i, contact in enumerate(contacts):
        if contact is None:
            continue
        color = _FINGERS[i % len(_FINGERS)]
        dot = _marker("contacts", i, Marker.ADD, Marker.SPHERE, color)
        dot.scale.x = dot.scale.y = dot.scale.z = 0.008
        made.append(_placed(dot, contact))
        force = forces[i] * scale
        if not (np.isfinite(force).all() and lengths[i] > 0.0):
            continue
        arrow = _marker("forces", i, Marker.ADD, Marker.ARROW, _FORCE)
        arrow.points = _points([np.zeros(3), force])
        arrow.scale.x, arrow.scale.y = 0.004, 0.009
        made.append(_placed(arrow, contact))
    return made


def _body(corners: Array) -> Marker:
    marker = _marker("object", 0, Marker.ADD, Marker.TRIANGLE_LIST)
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
    red, green, blue, alpha = color
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def _placed(marker: Marker, frame: Frame) -> Marker:
    _place(marker.pose.position, marker.pose.orientation, frame)
    return marker


def _place(at: Any, turn: Any, frame: Frame) -> None:
    at.x, at.y, at.z = map(float, frame.position)
    turn.x, turn.y, turn.z, turn.w = map(float, frame.quaternion)


def _points(corners: Iterable[Array]) -> list[Point]:
    return [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in corners]


def main(args: Sequence[str] | None = None) -> int:
    """Run the viewer until SIGINT or SIGTERM and return the exit code."""
    return run_node(ViewerNode, args)
