# SPDX-License-Identifier: Apache-2.0
"""The tactile sensor: simulated skin readings of the true contacts.

Safe state: without true contacts, forces and sliding it is silent, and the controller holds the
hand. Invalid input (NaN in a force, a wrong frame) is counted and dropped, and its tick gets no
answer. Its messages have no field for slip; a slip shows only as vibration of the forces. If it
crashes, nodes that wait for touch detect the silence.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.contact import example_touch
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.nodes.common import ReadingPublisher
from tactile_hand_ros.ros import streams
from tactile_hand_ros.ros.messages import Pose
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import TickInputs
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.simulation.skin import TactileReading, TactileSensor, TactileSensorConfig


class TactileSensorNode(TactileNode[TactileSensorConfig]):
    """Turns true contacts into tactile readings, tick by tick.

    Subscriptions: `ground_truth/contacts` (geometry_msgs/PoseArray, palm frame, m),
    `ground_truth/<finger>/wrench` (geometry_msgs/WrenchStamped, contact frame, N),
    `ground_truth/slip` (sensor_msgs/JointState by finger; only the sliding speed is used, m/s), all
    with the same timestamp. With errors of `calibration` also `joint_states`
    (sensor_msgs/JointState, rad).

    Publications, with the timestamp of the input: `tactile/contacts` (geometry_msgs/PoseArray, palm
    frame, m; NaN for fingers without contact), `tactile/<finger>/wrench`
    (geometry_msgs/WrenchStamped in `<finger>_contact`, N). Once a second: `/diagnostics`.

    Parameters: the fields of `TactileSensorConfig`; noise, resolution, vibration, dropout and
    faults are live. When the timestamps jump back, noise restarts from its seed.
    """

    def __init__(self, *, composed: bool = False, **kwargs: Any) -> None:
        """Build the sensor; with `composed` a chain calls `step` and no ticks are received."""
        super().__init__("tactile_sensor", TactileSensorConfig, **kwargs)
        hand = load_hand_config(self.config.hand)
        fingers = hand.finger_names
        self._fingers = len(fingers)
        declared: tuple[streams.Stream, ...] = (
            streams.true_contacts(len(fingers)),
            streams.true_sliding(fingers),
            streams.true_forces(fingers),
        )
        known, radii = None, np.array([finger.radius for finger in hand.fingers])
        if not (self.config.calibration.is_right and radii.all()):
            # Only a miscalibrated skin or fitted tips need the hand model, which is slow to load.
            from tactile_hand_ros.hand.hand import Hand

            known = Hand.load(self.config.hand, self.config.layout)
            declared, radii = (*declared, streams.joints(known.joint_names)), known.radii
        self._sensor = TactileSensor(self.config, radii, known)
        self._rehearse(len(fingers))
        self._publisher = ReadingPublisher(self, fingers, names.CONTACTS, names.wrench)
        if not composed:
            self._inputs = TickInputs(self, declared, self)

    def _rehearse(self, fingers: int) -> None:
        contacts, forces = example_touch(fingers)
        quaternions = quaternion_from_rotation(contacts.rotations)
        touch = TactileReading(contacts.positions, quaternions, forces)
        self._sensor.step(0, touch, np.zeros(fingers))
        self._sensor.reset()

    def check_config(self, config: TactileSensorConfig) -> None:
        """Reject faults that do not fit the number of fingers."""
        config.check_faults(self._fingers)

    def on_config(self, config: TactileSensorConfig) -> None:
        """Apply changed noise and faults."""
        self._sensor.configure(config)

    def on_restart(self) -> None:
        """Reset when the ticks start over; noise restarts from its seed."""
        self._sensor.reset()

    def on_tick(
        self,
        stamp: int,
        contacts: Pose,
        sliding: list[Array],
        forces: Array,
        joints: Joints | None = None,
    ) -> None:
        """Answer a complete tick."""
        true = TactileReading(*contacts, forces)
        self.step(stamp, true, sliding[1], None if joints is None else joints.theta)

    def step(
        self, stamp: int, true: TactileReading, sliding: Array, theta: Array | None = None
    ) -> TactileReading:
        """Publish and return the tactile reading; see `TactileSensor.step`."""
        with self.answering():
            touch = self._sensor.step(stamp, true, sliding, theta)
            self._publisher.publish(stamp, *touch)
        return touch
