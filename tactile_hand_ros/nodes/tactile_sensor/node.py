# SPDX-License-Identifier: Apache-2.0
"""The tactile sensor: what a skin would say of the true contacts.

Safe state: without true contacts, forces and sliding it says nothing, and the controller holds the
hand. Input that cannot be used (NaN in a force, a wrong frame) is counted and dropped, so that its
tick stays without an answer. Nothing of what it publishes tells slip: that shows in the vibration
of the forces only. When it dies, whoever waits for touch notices by the silence.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.rehearsal import example_touch
from tactile_hand_ros.nodes.readings import ReadingPublisher
from tactile_hand_ros.ros.messages.wire import ContactsCodec, SlipCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.ticks.backlog import Backlog
from tactile_hand_ros.ros.ticks.matching import REPEAT, StampMatcher
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.simulation.skin import TactileReading, TactileSensor, TactileSensorConfig


class TactileSensorNode(TactileNode[TactileSensorConfig]):
    """Turns true contacts into tactile readings, tick by tick.

    Subscriptions: `ground_truth/contacts` (geometry_msgs/PoseArray, palm frame, m),
    `ground_truth/<finger>/wrench` (geometry_msgs/WrenchStamped, contact frame, N),
    `ground_truth/slip` (sensor_msgs/JointState by finger, of which the sliding speed counts, m/s),
    all of one stamp.

    Publications, with the stamps of the input: `tactile/contacts` (geometry_msgs/PoseArray, palm
    frame, m; NaN where a finger does not touch), `tactile/<finger>/wrench`
    (geometry_msgs/WrenchStamped in `<finger>_contact`, N). Once a second: `/diagnostics`.

    Parameters: the fields of `TactileSensorConfig`; noise, resolution, vibration and dropout are
    live. When the stamps jump back, noise starts anew from its seed.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Build the sensor.

        Raises:
            TactileHandError: If a parameter is refused or there is no such hand.
        """
        super().__init__("tactile_sensor", TactileSensorConfig, **kwargs)
        hand = load_hand_config(self.config.hand)
        fingers = hand.finger_names
        self._sensor = TactileSensor(self.config, np.array(hand.radii))
        self._rehearse(len(fingers))
        self._publisher = ReadingPublisher(self, fingers, names.CONTACTS, names.wrench)
        self._contacts = ContactsCodec(len(fingers))
        topics = [names.true_wrench(name) for name in fingers]
        keys = (names.TRUE_CONTACTS, names.TRUE_SLIP, *topics)
        self._backlog = Backlog(self, names.TRUE_CONTACTS, self._on_tick)
        self._matcher = StampMatcher(keys, on_restart=self._restart)
        self._slip = SlipCodec(fingers)
        self.subscribe(PoseArray, names.TRUE_CONTACTS, self._on_contacts, raw=True)
        self.subscribe(JointState, names.TRUE_SLIP, self._on_slip, raw=True)
        for name, topic in zip(fingers, topics, strict=True):
            codec = WrenchCodec(names.contact_frame(name))
            self.subscribe(WrenchStamped, topic, partial(self._on_wrench, topic, codec), raw=True)

    def _rehearse(self, fingers: int) -> None:
        contacts, forces = example_touch(fingers)
        quaternions = quaternion_from_rotation(contacts.rotations)
        touch = TactileReading(contacts.positions, quaternions, forces)
        self._sensor.step(0, touch, np.zeros(fingers))
        self._sensor.reset()

    def on_config(self, config: TactileSensorConfig) -> None:
        """Take other noise."""
        self._sensor.configure(config)

    def _on_contacts(self, data: bytes) -> None:
        stamp, contacts = self._contacts.decode(data)
        self._take(names.TRUE_CONTACTS, stamp, contacts)

    def _on_slip(self, data: bytes) -> None:
        stamp, (_, speeds) = self._slip.decode(data)
        self._take(names.TRUE_SLIP, stamp, speeds)

    def _on_wrench(self, topic: str, codec: WrenchCodec, data: bytes) -> None:
        stamp, force = codec.decode(data)
        self._take(topic, stamp, force)

    def _take(self, key: str, stamp: int, value: Any) -> None:
        matched = self._matcher.put(key, stamp, value)
        if matched is REPEAT:
            self._backlog.repeat(self._publisher.repeat)
        elif matched is not None:
            self._backlog.put(stamp, matched)

    def _restart(self) -> None:
        self._backlog.clear()
        self._sensor.reset()

    def _on_tick(self, stamp: int, heard: tuple[Any, ...]) -> None:
        began = time.perf_counter()
        (positions, quaternions), speeds, *forces = heard
        true = TactileReading(positions, quaternions, np.array(forces))
        self._publisher.publish(self._sensor.step(stamp, true, speeds), stamp)
        self.diagnostics.tick()
        self.diagnostics.latency(time.perf_counter() - began)


def main(args: Sequence[str] | None = None) -> int:
    """Run the tactile sensor until SIGINT or SIGTERM and return the exit code."""
    return run_node(TactileSensorNode, args)


if __name__ == "__main__":
    sys.exit(main())
