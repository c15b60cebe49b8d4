# SPDX-License-Identifier: Apache-2.0
"""What the plant says at each tick: joints for all, the ground truth for those who may know it."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from tactile_hand_ros import names
from tactile_hand_ros.cdr import clock_bytes
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.readings import ReadingPublisher
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages.wire import JointCodec, PoseCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.simulation.plant import PlantState, sliding_speeds, true_reading


class PlantTopics:
    """Publishes the state of a plant, and once and for all the URDF of its hand."""

    def __init__(self, node: TactileNode[Any], hand: Hand) -> None:
        """Create the publishers and describe the hand."""
        self._truth = ReadingPublisher(
            node, hand.finger_names, names.TRUE_CONTACTS, names.true_wrench
        )
        self._slip = JointCodec(hand.finger_names, ("position", "velocity"))
        self._slip_publisher = node.tick_publisher(JointState, names.TRUE_SLIP)
        self._joints = JointCodec(hand.joint_names, ("position", "velocity", "effort"))
        self._joints_publisher = node.tick_publisher(JointState, names.JOINT_STATES)
        self._pose = PoseCodec()
        self._pose_publisher = node.tick_publisher(PoseStamped, names.OBJECT_POSE)
        self._clock_publisher = node.tick_publisher(Clock, names.CLOCK)
        self._joints_sent = self._slip_sent = b""
        latched = qos.latched_qos()
        self._description = node.create_publisher(String, names.ROBOT_DESCRIPTION, latched)
        self._description.publish(String(data=hand.description))
        self._hold = node.create_publisher(Bool, names.JOINT_HOLD, latched)
        self._is_held: bool | None = None

    def publish(self, state: PlantState, stamp_ns: int) -> None:
        """Publish a tick [ns], first what others wait for."""
        self._slip_sent = self._slip.encode(stamp_ns, state.slid, sliding_speeds(state))
        self._slip_publisher.publish(self._slip_sent)
        self._truth.publish(true_reading(state), stamp_ns)
        self._joints_sent = self._joints.encode(stamp_ns, state.theta, state.rates, state.torque)
        self._joints_publisher.publish(self._joints_sent)
        quaternion = quaternion_from_rotation(state.rotation)
        self._pose_publisher.publish(self._pose.encode(state.position, quaternion, stamp_ns))
        self._clock_publisher.publish(clock_bytes(stamp_ns))

    def tell_hold(self, is_held: bool) -> None:
        """Publish whether the joints are held, where that has changed."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._hold.publish(Bool(data=is_held))

    def repeat(self) -> None:
        """Publish what others wait for once more, byte by byte."""
        self._slip_publisher.publish(self._slip_sent)
        self._truth.repeat()
        self._joints_publisher.publish(self._joints_sent)
