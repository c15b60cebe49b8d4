# SPDX-License-Identifier: Apache-2.0
"""The viewer: transforms and markers for RViz, Foxglove and PlotJuggler, a few times a second.

For each picture it takes the newest message of each topic, so it is cheap at any tick rate. No
other node depends on it. The links of the hand come from robot_state_publisher. Without tf2_msgs
there are no transforms; the markers need none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    PoseArray,
    PoseStamped,
    TransformStamped,
    Vector3,
    WrenchStamped,
)
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.time import Time as RosTime
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import is_reset
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest
from tactile_hand_ros.ros.messages import ContactsCodec, Pose, PoseCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.simulation.plant_config import ObjectConfig

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the pip wheels, but part of every full installation
    TFMessage = None

_LONGEST = 0.12
"""Length of the arrow of the strongest force [m]."""

_STYLES = {
    "object": (Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0), (0.56, 0.65, 0.75, 0.4)),
    "goal": (Marker.LINE_LIST, (0.003, 0.0, 0.0), (0.76, 0.09, 0.36, 1.0)),
    "contacts": (Marker.SPHERE, (0.008, 0.008, 0.008), (0.0, 0.45, 0.7, 1.0)),
    "forces": (Marker.ARROW, (0.004, 0.009, 0.0), (0.1, 0.14, 0.19, 1.0)),
}
"""Type, scale and color (red, green, blue, alpha) of the markers of each namespace."""


class ViewerConfig(Config):
    """Configuration of the viewer."""

    hand: str = param("paper", "hand by name or YAML file")
    rate: float = param(30.0, "pictures per second", unit="Hz", gt=0.0, le=100.0)
    object: ObjectConfig = ObjectConfig()


class ViewerNode(TactileNode[ViewerConfig]):
    """Publishes transforms and markers.

    Subscriptions, newest message only: `tactile/contacts`, `tactile/<finger>/wrench`,
    `accepted/desired_pose`, `ground_truth/object_pose`.

    Publications: `markers` (visualization_msgs/MarkerArray in `palm`, only while there is a
    subscriber), `/tf` (tf2_msgs/TFMessage, if installed: from `palm` to contacts, object and goal).
    In a namespace, frame names are prefixed with it, as in `left/palm`, because all hands share
    `/tf`.

    Parameters: the fields of `ViewerConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Subscribe and create the publishers."""
        super().__init__("viewer", ViewerConfig, **kwargs)
        self._fingers = load_hand_config(self.config.hand).finger_names
        self._corners = self.config.object.solid().triangles().reshape(-1, 3)
        self._prefix = f"{self.get_namespace()}/".lstrip("/")
        self._time = 0  # of the last contacts, ns
        self._inputs: dict[str, tuple[Subscription, Callable[[bytes], Any]]] = {}
        self._newest: dict[str, tuple[int, Any]] = {}
        self._subscribe(names.CONTACTS, PoseArray, ContactsCodec(len(self._fingers)).decode)
        for topic in (names.ACCEPTED_POSE, names.OBJECT_POSE):
            self._subscribe(topic, PoseStamped, PoseCodec().decode)
        codec = WrenchCodec("", any_frame=True, normal_allowed=True)
        for finger in self._fingers:
            self._subscribe(names.wrench(finger), WrenchStamped, codec.decode)
        self._markers = self.create_publisher(MarkerArray, "markers", qos.USER_DEPTH)
        self._tf = None
        if TFMessage is None:
            self.diagnostics.value("tf", "tf2_msgs is not installed")
        else:
            self._tf = self.create_publisher(TFMessage, "/tf", qos.USER_DEPTH)
        self.create_timer(1.0 / self.config.rate, self.show)

    def _subscribe(self, topic: str, kind: Any, decode: Callable[[bytes], Any]) -> None:
        """Subscribe to publishers of any reliability."""
        profile = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._inputs[topic] = subscribe_directly(self, kind, topic, profile), decode

    def show(self) -> None:
        """Publish transforms and markers of the newest messages."""
        for topic, (subscription, decode) in self._inputs.items():
            data = take_latest(subscription)
            if data is not None:
                self._newest.pop(topic, None)
                with suppress(MessageError):  # the controllers reject and report it
                    self._newest[topic] = decode(data)
                    if topic == names.CONTACTS:
                        self._note_time(self._newest[topic][0])
        frames = self._frames()
        if self._tf is not None and names.CONTACTS in self._newest:
            stamp = RosTime(nanoseconds=self._newest[names.CONTACTS][0]).to_msg()
            made = [self._transform(stamp, name, pose) for name, pose in frames.items()]
            self._tf.publish(TFMessage(transforms=made))
        if self._markers.get_subscription_count():
            self._markers.publish(MarkerArray(markers=self._picture(frames)))
        self.diagnostics.tick()

    def _note_time(self, stamp: int) -> None:
        """Forget the goal, too, at a reset."""
        if is_reset(self._time, stamp):
            self._newest.pop(names.ACCEPTED_POSE, None)
        self._time = stamp

    def _frames(self) -> dict[str, Pose]:
        """Return the known contact frames, object and goal in the palm frame."""
        found = {}
        if names.CONTACTS in self._newest:
            _, contacts = self._newest[names.CONTACTS]
            for finger, *place in zip(self._fingers, *contacts, strict=True):
                found[names.contact_frame(finger)] = Pose(*place)
        for name, topic in (("object", names.OBJECT_POSE), ("goal", names.ACCEPTED_POSE)):
            if topic in self._newest:
                found[name] = self._newest[topic][1]
        return {name: pose for name, pose in found.items() if np.isfinite(pose.position).all()}

    def _transform(self, stamp: Time, name: str, pose: Pose) -> TransformStamped:
        message = TransformStamped(child_frame_id=self._prefix + name)
        message.header.frame_id, message.header.stamp = self._prefix + names.PALM_FRAME, stamp
        _place(message.transform.translation, message.transform.rotation, pose)
        return message

    def _picture(self, frames: dict[str, Pose]) -> list[Marker]:
        """Return the markers of a picture; the first removes those of the last one."""
        made = [Marker(action=Marker.DELETEALL)]
        axes = [end for axis in 0.05 * np.eye(3) for end in (np.zeros(3), axis)]
        for name, points in (("object", self._corners), ("goal", axes)):
            if name in frames:
                made.append(self._marker(name, 0, frames[name], points))
        unknown = 0, (np.nan,) * 3
        given = [self._newest.get(names.wrench(finger), unknown)[1] for finger in self._fingers]
        forces = known_part(np.array(given))
        scale = _LONGEST / np.nanmax(np.linalg.norm(forces, axis=1), initial=1e-9)
        for i, finger in enumerate(self._fingers):
            contact = frames.get(names.contact_frame(finger))
            if contact is None:
                continue
            made.append(self._marker("contacts", i, contact))
            if forces[i].any() and np.isfinite(forces[i]).all():
                arrow = [np.zeros(3), scale * forces[i]]
                made.append(self._marker("forces", i, contact, arrow))
        return made

    def _marker(self, namespace: str, i: int, pose: Pose, points: Iterable[Any] = ()) -> Marker:
        """Return a marker without timestamp: the current position."""
        kind, scale, color = _STYLES[namespace]
        marker = Marker(ns=namespace, id=i, type=kind)
        marker.header.frame_id = self._prefix + names.PALM_FRAME
        _place(marker.pose.position, marker.pose.orientation, pose)
        marker.scale = Vector3(**dict(zip("xyz", scale, strict=True)))
        marker.color = ColorRGBA(**dict(zip("rgba", color, strict=True)))
        marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in points]
        return marker


def _place(at: Any, turn: Any, pose: Pose) -> None:
    at.x, at.y, at.z = map(float, pose.position)
    turn.x, turn.y, turn.z, turn.w = map(float, pose.quaternion)
