# SPDX-License-Identifier: Apache-2.0
"""The user of a running hand: sends one command and waits for what became of it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import ArrayLike, NDArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages.conversions import pose_from_ros, stamp_to_ns
from tactile_hand_ros.ros.messages.wire import PoseCodec
from tactile_hand_ros.rotations import quaternion_from_rotation, rotation_from_vector

Array = NDArray[np.float64]

_SLICE = 0.02  # s
_AGAIN = 1.0  # s without an answer after which a command is sent again


class SteeringError(TactileHandError):
    """The hand is not there, does not answer, or refuses a command."""


@contextlib.contextmanager
def user_node(context: Context, namespace: str) -> Iterator[Node]:
    """Provide a node of this process; its name is its own, so that users do not collide."""
    name = f"user_{os.getpid()}"
    node = Node(name, namespace=namespace, context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()


class HandClient:
    """Commands for one hand; each returns when the hand has answered.

    A command is sent when the node that acts on it has been met, and so is never lost.
    """

    def __init__(self, node: Node, timeout: float) -> None:
        """Prepare.

        Args:
            node: A node in the namespace of the hand.
            timeout: Longest wait for the hand to be found, and for its answer [s].
        """
        self._node, self._timeout = node, timeout
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def move(self, position: ArrayLike, turn: ArrayLike, *, absolute: bool) -> float:
        """Ask for a pose of the grasp.

        Args:
            position: p_d of the contact centroid, palm frame, shape (3,), m.
            turn: Rotation vector, palm axes, shape (3,), rad.
            absolute: Whether the turn is the orientation itself, or counts from the present one.

        Returns:
            The simulated time from which the pose is the target [s].

        Raises:
            SteeringError: If there is no hand, or it refuses.
        """
        publisher = self._node.create_publisher(PoseStamped, names.DESIRED_POSE, qos.user_qos())
        now = np.eye(3) if absolute else self._orientation()
        quaternion = quaternion_from_rotation(rotation_from_vector(turn) @ now)
        data = PoseCodec().encode(np.asarray(position, dtype=np.float64), quaternion, 0)
        wanted = deserialize_message(data, PoseStamped).pose
        accepted = (PoseStamped, names.ACCEPTED_POSE, lambda message: message.pose == wanted)
        return self._send(publisher, data, names.CONTROLLER, names.DESIRED_POSE, accepted)

    def squeeze(self, force: float) -> float:
        """Ask for a squeeze k_f [N] and return the simulated time at which it takes effect [s].

        Raises:
            SteeringError: If there is no hand, or it refuses.
        """
        publisher = self._node.create_publisher(Float64, names.USER_GRASP_FORCE, qos.user_qos())
        accepted = (WrenchStamped, names.ACCEPTED_FORCE, lambda m: m.wrench.force.y == force)
        message = Float64(data=force)
        return self._send(publisher, message, names.REGULATOR, names.USER_GRASP_FORCE, accepted)

    def grasp(self, close: bool) -> str:
        """Close the fingers until all touch, or open them; return what the hand says.

        Raises:
            SteeringError: If there is no hand, or it refuses.
        """
        return self._call(SetBool, f"{names.CONTROLLER}/grasp", SetBool.Request(data=close))

    def reset(self) -> str:
        """Begin again: a simulation at its start, a real hand with its present grasp.

        Raises:
            SteeringError: If there is no hand, or it refuses.
        """
        last = f"{names.CONTROLLER}/reset"
        self._wait_for_service(self._node.create_client(Trigger, last))
        offered = {name for name, _ in self._node.get_service_names_and_types()}
        plant = f"{names.PLANT}/reset"
        if f"{self._node.get_namespace().rstrip('/')}/{plant}" in offered:
            self._call(Trigger, plant, Trigger.Request())
            return "time, hand and object are back at the start"
        self._call(Trigger, f"{names.REGULATOR}/reset", Trigger.Request())
        return self._call(Trigger, last, Trigger.Request())

    def _orientation(self) -> Array:
        """Return the orientation that the grasp has now, shape (3, 3)."""
        found: list[PoseStamped] = []
        self._node.create_subscription(
            PoseStamped, names.AUXILIARY_POSE, found.append, qos.tick_qos()
        )
        self._wait(
            lambda: bool(found),
            "the hand does not know the pose of its grasp now (nothing on auxiliary_pose within "
            f"{self._timeout:g} s); is it running, and do all fingers touch?",
            present=names.DESIRED_POSE,
        )
        return np.asarray(pose_from_ros(found[0]).rotation)

    def _send(
        self,
        publisher: Any,
        message: Any,
        node: str,
        topic: str,
        accepted: tuple[Any, str, Callable[[Any], bool]],
    ) -> float:
        """Send a command to a node and return the time in its acceptance [s]."""
        taken: list[Any] = []
        refused: list[DiagnosticArray] = []
        kind, name, is_ours = accepted
        listening = [
            self._node.create_subscription(
                kind, name, lambda m: taken.append(m) if is_ours(m) else None, qos.user_qos()
            ),
            self._node.create_subscription(
                DiagnosticArray, names.rejected(node), refused.append, qos.user_qos()
            ),
        ]
        self._wait(
            lambda: (
                publisher.get_subscription_count() > 0
                and all(each.get_publisher_count() > 0 for each in listening)
            ),
            self._absence(),
        )

        due = time.monotonic()

        def answered() -> bool:
            # Whether the hand has met our subscriptions, only the hand knows: an answer to the
            # first message may have missed them.
            nonlocal due
            if time.monotonic() >= due:
                publisher.publish(message)
                due = time.monotonic() + _AGAIN
            return bool(taken or refused)

        self._wait(
            answered,
            f"the hand has not answered within {self._timeout:g} s; is it paused?",
        )
        if not taken:
            raise SteeringError(f"the hand refuses: {_reason(refused, topic)}")
        return 1e-9 * stamp_to_ns(taken[0].header.stamp)

    def _call(self, kind: Any, service: str, request: Any) -> str:
        client = self._node.create_client(kind, service)
        self._wait_for_service(client)
        future = client.call_async(request)
        self._wait(future.done, f"{service} has not answered within {self._timeout:g} s")
        answer = future.result()
        if not answer.success:
            raise SteeringError(f"the hand refuses: {answer.message}")
        return str(answer.message)

    def _wait_for_service(self, client: Any) -> None:
        self._wait(client.service_is_ready, self._absence())

    def _wait(self, condition: Callable[[], bool], problem: str, present: str = "") -> None:
        """Wait for a condition.

        Args:
            condition: What to wait for.
            problem: What is wrong when it does not come.
            present: A topic without which the hand is not there at all.

        Raises:
            SteeringError: If it does not come in time.
        """
        end = time.monotonic() + self._timeout
        while not condition():
            if time.monotonic() > end:
                if present and not self._node.count_subscribers(present):
                    problem = self._absence()
                raise SteeringError(problem)
            self._executor.spin_once(timeout_sec=_SLICE)

    def _absence(self) -> str:
        domain, namespace = self._node.context.get_domain_id(), self._node.get_namespace()
        return (
            f"no hand is running in ROS domain {domain} and namespace '{namespace}'; start one with"
            " `tactile-hand run --interactive`, or give its --namespace or ROS_DOMAIN_ID"
        )


def _reason(refused: list[DiagnosticArray], topic: str) -> str:
    """Return why a command on a topic was refused."""
    found = [p.value for m in refused for s in m.status for p in s.values if p.key == topic]
    return found[0] if found else "it does not say why"
