# SPDX-License-Identifier: Apache-2.0
"""The viewer: what RViz, Foxglove and PlotJuggler need to show a hand, a few times a second.

It takes the newest message of each topic when a picture is due, so it costs little at any tick
rate, and nothing depends on it. Without tf2_msgs there are no transforms; the markers need none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import Content, read_content
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.viewer.scene import (
    OBJECT_FRAME,
    Frame,
    LinkFrames,
    Scene,
    frame_prefix,
    markers,
    transforms,
)
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest
from tactile_hand_ros.ros.messages import ContactsCodec, PoseCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.simulation.plant_config import ObjectConfig

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels; part of every full installation
    TFMessage = None

Array = NDArray[np.float64]

MARKERS = "markers"


class ViewerConfig(Config):
    """What is shown."""

    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    rate: float = param(30.0, "pictures per second", unit="Hz", gt=0.0, le=100.0)
    object: ObjectConfig = ObjectConfig()


class ViewerNode(TactileNode[ViewerConfig]):
    """Publishes transforms and markers.

    Subscriptions, of which the newest message counts: `joint_states`, `tactile/contacts`,
    `tactile/<finger>/wrench`, `grip_state`, `accepted/desired_pose`, `ground_truth/object_pose`.

    Publications: `markers` (visualization_msgs/MarkerArray in `palm`, only while there is a
    subscriber), `/tf` and `/tf_static` (tf2_msgs/TFMessage, where it is installed: from `palm` to
    links, contacts and object). In a namespace the names of these frames start with it, as
    `left/palm`: all hands use one `/tf`.

    Parameters: the fields of `ViewerConfig`; a plant's parameter file fits as well.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Read the hand.

        Raises:
            TactileHandError: If a parameter is refused or there is no such hand.
        """
        super().__init__("viewer", ViewerConfig, **kwargs)
        hand = Hand.load(self.config.hand, self.config.layout)
        self._fingers, self._links = hand.finger_names, LinkFrames(hand.description)
        self._corners = _triangles(self.config.object)
        self._prefix = frame_prefix(self.get_namespace())
        self._taken: dict[str, Any] = {}
        pose, joints = PoseCodec().decode, partial(read_content, "sensor_msgs/msg/JointState")
        listened: dict[str, tuple[Any, Callable[[bytes], Any]]] = {
            names.JOINT_STATES: (JointState, joints),
            names.CONTACTS: (PoseArray, ContactsCodec(len(self._fingers)).decode),
            names.GRIP_STATE: (JointState, joints),
            names.ACCEPTED_POSE: (PoseStamped, pose),
            names.OBJECT_POSE: (PoseStamped, pose),
        }
        for finger in self._fingers:
            force = WrenchCodec(names.contact_frame(finger), any_frame=True).decode
            listened[names.wrench(finger)] = WrenchStamped, force
        self._listening = {
            topic: (self._listen(kind, topic), decode) for topic, (kind, decode) in listened.items()
        }
        self._markers = self.create_publisher(MarkerArray, MARKERS, qos.user_qos())
        self._tf = self._publish_static()
        self.create_timer(1.0 / self.config.rate, self.show)

    def _listen(self, kind: Any, topic: str) -> Subscription:
        """Subscribe to publishers of any reliability, unless the user overrides it."""
        profile = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        options = QoSOverridingOptions.with_default_policies()
        return subscribe_directly(self, kind, topic, profile, qos_overriding_options=options)

    def _publish_static(self) -> Any:
        """Publish what does not move, and return the publisher of what does, None without tf2."""
        if TFMessage is None:
            self.diagnostics.value("tf", "tf2_msgs is not installed")
            return None
        self._static = self.create_publisher(TFMessage, "/tf_static", qos.latched_qos())
        self._static.publish(self._transforms(self._links.fixed(), 0))
        return self.create_publisher(TFMessage, "/tf", qos.user_qos())

    def show(self) -> None:
        """Publish a picture of what is known now."""
        for topic, (subscription, decode) in self._listening.items():
            self._take(topic, subscription, decode)
        contacts = self._contacts()
        where = self._pose(names.OBJECT_POSE, OBJECT_FRAME)
        if self._tf is not None and names.JOINT_STATES in self._taken:
            stamp = self._taken[names.JOINT_STATES].stamp
            seen = [*self._links.moving(self._theta()), *(c for c in contacts if c.is_known)]
            known = [where] if where is not None and where.is_known else []
            self._tf.publish(self._transforms([*seen, *known], stamp))
        if self._markers.get_subscription_count():
            goal = self._pose(names.ACCEPTED_POSE, "goal")
            measured = self._forces(), self._friction()
            scene = Scene(self._corners, where, contacts, *measured, goal, self._prefix)
            self._markers.publish(markers(scene))
        self.diagnostics.tick()

    def _transforms(self, frames: list[Frame], stamp_ns: int) -> Any:
        return TFMessage(transforms=transforms(frames, stamp_ns, self._prefix))

    def _take(self, topic: str, subscription: Subscription, decode: Callable[[bytes], Any]) -> None:
        data = take_latest(subscription)
        if data is not None:
            self._taken.pop(topic, None)
            with suppress(MessageError):  # the controllers refuse it, and report it
                self._taken[topic] = decode(data)

    def _theta(self) -> Array:
        angles = _by_name(self._taken[names.JOINT_STATES])
        return np.array([angles.get(name, 0.0) for name in self._links.joint_names])

    def _contacts(self) -> list[Frame]:
        """Return the contact of each finger, NaN where it does not touch."""
        k = len(self._fingers)
        positions, quaternions = np.full((k, 3), np.nan), np.full((k, 4), np.nan)
        if names.CONTACTS in self._taken:
            _, (positions, quaternions) = self._taken[names.CONTACTS]
        places = zip(self._fingers, positions, quaternions, strict=True)
        return [Frame(names.contact_frame(finger), *place) for finger, *place in places]

    def _forces(self) -> Array:
        forces = np.full((len(self._fingers), 3), np.nan)
        for i, finger in enumerate(self._fingers):
            if names.wrench(finger) in self._taken:
                _, forces[i] = self._taken[names.wrench(finger)]
        return forces

    def _friction(self) -> Array:
        grip = self._taken.get(names.GRIP_STATE)
        known = {} if grip is None else _by_name(grip)
        return np.array([known.get(finger, np.nan) for finger in self._fingers])

    def _pose(self, topic: str, name: str) -> Frame | None:
        if topic not in self._taken:
            return None
        _, pose = self._taken[topic]
        return Frame(name, pose.position, pose.quaternion)


def _by_name(joints: Content) -> dict[str, float]:
    """Return the positions in joint states by name."""
    return dict(zip(joints.texts[1:], joints.doubles["position"].tolist(), strict=False))


def _triangles(config: ObjectConfig) -> Array:
    """Return the corners of the object's faces, cut into triangles, shape (3 t, 3), m."""
    solid = config.solid()
    corners = [
        solid.vertices[index]
        for face in solid.face_corners
        for pair in zip(face[1:], face[2:], strict=False)
        for index in (face[0], *pair)
    ]
    return np.array(corners)


def main(args: Sequence[str] | None = None) -> int:
    """Run the viewer until SIGINT or SIGTERM and return the exit code."""
    return run_node(ViewerNode, args)
