# SPDX-License-Identifier: Apache-2.0
"""Several nodes in one process, wired by direct calls.

`composed` runs plant, sensor, regulator, optimizer and controller, for computers with few cores;
``--record`` adds the recorder. `controllers` runs regulator, optimizer and controller for a real
hand.

Topics, parameters, services and results match those of separate processes bit for bit. The nodes
wrap the blocks of a chain from `closed_loop`: each node computes with its block and publishes the
answer. A message is encoded only for a subscriber or the recorder. The cost is isolation: all nodes
crash together, and the drivers of a real hand must then hold the joints.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from typing import Any, cast

from rclpy.node import Node
from std_msgs.msg import Bool

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import Chain, SensingChain
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.names import RECORD
from tactile_hand_ros.nodes.force_optimizer import ForceOptimizerNode
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.nodes.tactile_sensor import TactileSensorNode
from tactile_hand_ros.ros import qos, streams
from tactile_hand_ros.ros.endpoints import TickFailedError
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_nodes
from tactile_hand_ros.ros.ticks import TickInputs
from tactile_hand_ros.simulation.plant import PlantState

MEMBERS = (
    PlantNode,
    TactileSensorNode,
    SlipRegulatorNode,
    ForceOptimizerNode,
    ManipulationControllerNode,
)
CONTROLLERS = MEMBERS[2:]


class _Wired:
    """Nodes that a chain calls; they were created with `composed`."""

    def __init__(self, *nodes: TactileNode[Any]) -> None:
        self._nodes = nodes
        self._controller = cast(ManipulationControllerNode, nodes[-1])

    def on_repeat(self) -> None:
        """Publish the last answers again."""
        for node in self._nodes:
            node.on_repeat()

    def on_restart(self) -> None:
        """Reset the nodes after the timestamps have started over."""
        for node in self._nodes:
            node.on_restart()


class ComposedHand(_Wired):
    """The nodes that answer the plant's ticks in its process: sensor to controller."""

    def __init__(self, *nodes: TactileNode[Any]) -> None:
        """Wire the nodes."""
        super().__init__(*nodes)
        self._chain = SensingChain(*cast(Any, (*nodes[1:], nodes[0])))
        self._last: tuple[int, Array | None] = -1, None

    def answer(self, stamp: int, state: PlantState) -> Array | None:
        """Publish all answers to a tick and return the torque, shape (m,), N m.

        It is None if a node failed or it must not be sent. A repeated tick gets the same answer.
        """
        if stamp == self._last[0]:
            self.on_repeat()
            return self._last[1]
        torque = None
        try:
            command = self._chain.sense(stamp, state)[1].command
        except TickFailedError:
            pass
        else:
            torque = None if command.do_not_send else command.torque
        self._last = stamp, torque
        return torque

    def hold(self, held: bool) -> None:
        """Set whether the guard holds the joints."""
        self._controller.joints_held = held

    def on_restart(self) -> None:
        """Start over after time was set back."""
        self._last = -1, None
        super().on_restart()


class TouchedHand(_Wired):
    """The three controllers of a real hand, whose drivers provide joints and touch."""

    def __init__(self, *nodes: TactileNode[Any]) -> None:
        """Wire the nodes and subscribe."""
        super().__init__(*nodes)
        self._chain = Chain(*cast(Any, nodes))
        regulator = cast(SlipRegulatorNode, nodes[0])
        controller, hand = self._controller, self._controller.hand
        declared = [
            streams.joints(hand.joint_names),
            streams.contacts(hand.fingers),
            streams.forces(hand.finger_names),
        ]
        if controller.config.imu:
            declared.append(streams.imu())
        silence, held = controller.config.input_timeout, qos.latched_qos(qos.USER_DEPTH)
        controller.subscribe(Bool, names.JOINT_HOLD, self._on_joint_hold, profile=held)
        self._inputs = TickInputs(
            controller,
            declared,
            self,
            observe=lambda stamp, joints, *seen: regulator.observe(stamp, seen[0], seen[1], joints),
            silence=silence,
        )

    def _on_joint_hold(self, message: Bool) -> None:
        self._controller.joints_held = message.data

    def on_tick(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts,
        forces: Array,
        palm: Array | None = None,
    ) -> None:
        """Answer a complete tick."""
        if palm is not None:
            self._controller.turn_palm(palm)
        self._chain.answer(stamp, joints, contacts, forces)

    def on_blind_tick(self, stamp: int, joints: Joints, reason: str) -> None:
        """Hold the hand at a tick without touch."""
        self._controller.on_blind_tick(stamp, joints, reason)


def composed_nodes(*, record: bool = False, **kwargs: Any) -> Iterator[Node]:
    """Create and start all nodes; ``--record``, here `record`, adds the recorder."""
    members: list[Any] = []
    for kind in MEMBERS[:-1]:
        members.append(kind(composed=True, **kwargs))
        yield members[-1]
    plant, *others = members
    time_waits = plant.config.pacing == "lockstep"
    others.append(ManipulationControllerNode(composed=True, time_waits=time_waits, **kwargs))
    yield others[-1]
    if record:
        from tactile_hand_ros.nodes.recorder.node import RecorderNode

        publishers = [each for node in (plant, *others) for each in node.tick_publishers]
        yield RecorderNode(publishers, **kwargs)
    plant.begin(ComposedHand(*others))


def controller_nodes(**kwargs: Any) -> Iterator[Node]:
    """Create the nodes of a real hand."""
    members: list[Any] = []
    for kind in CONTROLLERS:
        members.append(kind(composed=True, **kwargs))
        yield members[-1]
    TouchedHand(*members)


def main() -> int:
    """Run all nodes until SIGINT or SIGTERM and return the exit code."""
    make = partial(composed_nodes, record=RECORD in sys.argv)
    line = [word for word in sys.argv if word != RECORD]
    return run_nodes(make, line, described=[composed_nodes, *MEMBERS])
