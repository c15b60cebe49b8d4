# SPDX-License-Identifier: Apache-2.0
"""Commands to a running hand, from the orchestrator and from users in other terminals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec
from tactile_hand_ros.ros.node import PUBLICATIONS
from tactile_hand_ros.rotations import (
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)

if TYPE_CHECKING:
    from tactile_hand_ros.scenario.scenario import Scenario

_SLICE = 0.02  # s
_PATIENCE = 5.0  # s, longest wait for an answer to the orchestrator
_AGAIN = 1.0  # s without an answer after which a command is resent
_UNDISCOVERED = "_NODE_NAME_UNKNOWN_"  # rmw's name for an endpoint of an undiscovered node


class SteeringError(TactileHandError):
    """The hand is absent, does not answer, or rejects a command."""


class Steering:
    """The orchestrator's commands: targets, user grasp forces, and run or pause."""

    def __init__(self, node: Node, scenario: Scenario, check: Callable[[], None]) -> None:
        """Create publishers and client; `check` is called while waiting and raises to give up."""
        self._targets, self._check = scenario.targets, check
        self._waiting = sorted(scenario.user_forces, key=lambda request: request.time)
        # A queue of one is full with each message. Only then does Fast DDS request the
        # acknowledgment immediately; otherwise it does so every 3 s.
        self._poses = node.create_publisher(PoseStamped, names.DESIRED_POSE, 1)
        self._forces = node.create_publisher(Float64, names.USER_GRASP_FORCE, 1)
        self._client = node.create_client(SetBool, f"{names.PLANT}/run")
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    @property
    def is_ready(self) -> bool:
        """Whether the plant's service can be called."""
        return bool(self._client.service_is_ready())

    @property
    def facts(self) -> dict[str, str]:
        """The number of matched subscribers of each publisher, in the format of the diagnostics."""
        ours = (self._poses, self._forces)
        return {f"{PUBLICATIONS} {p.topic_name}": str(p.get_subscription_count()) for p in ours}

    def send_targets(self) -> None:
        """Send the desired poses with their ticks; raise SteeringError without acknowledgment."""
        for target in self._targets:
            pose, codec = target.target(), PoseCodec(nan_allowed=True)
            self._poses.publish(codec.encode(pose.position, pose.quaternion, target.stamp))
            self._deliver(self._poses, f"the desired pose for t = {target.time} s")

    def send_forces(self, stamp: int) -> None:
        """Send the newest user grasp force that is due at a tick [ns], if there is one.

        Like all manual commands, forces carry no timestamp: when one takes effect depends on its
        travel time and may vary between runs. Raise SteeringError if it is not acknowledged.
        """
        due = [each for each in self._waiting if each.stamp <= stamp]
        self._waiting = self._waiting[len(due) :]
        if due:
            self._forces.publish(Float64(data=float(due[-1].force)))
            self._deliver(self._forces, f"the grasp force for t = {due[-1].time} s")

    def _deliver(self, publisher: Publisher, what: str) -> None:
        end = time.monotonic() + _PATIENCE
        while not publisher.wait_for_all_acked(Duration(seconds=_SLICE)):
            self._check()
            if time.monotonic() > end:
                raise SteeringError(
                    f"{what} was not received by all subscribers within {_PATIENCE:g} s; see the "
                    "logs of the nodes"
                )

    def run(self, on: bool, timeout: float = _PATIENCE, check: bool = True) -> None:
        """Let the plant run or pause, and wait for its answer, at most `timeout` [s].

        With `check`, the constructor's `check` may end the wait early. Raise SteeringError if the
        plant rejects the call or does not answer.
        """
        future = self._client.call_async(SetBool.Request(data=on))

        def done() -> bool:
            if check:
                self._check()
            return bool(future.done())

        if not _spin(self._executor, done, timeout):
            raise SteeringError(f"the plant did not answer to ~/run within {timeout:g} s")
        if not future.result().success:
            raise SteeringError(f"the plant rejects ~/run: {future.result().message}")


def _spin(executor: SingleThreadedExecutor, condition: Callable[[], bool], timeout: float) -> bool:
    """Return whether a condition becomes true within `timeout` [s]."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        executor.spin_once(timeout_sec=_SLICE)
    return True


class HandClient:
    """User commands to one hand; each returns when the hand has answered.

    A command is sent only after its receiver has been discovered, so it is never lost.
    """

    def __init__(self, node: Node, timeout: float) -> None:
        """Prepare; `timeout` limits the waits for discovery and for an answer [s]."""
        self._node, self._timeout = node, timeout
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def move(
        self, position: Sequence[float], rotation: Sequence[float] | None
    ) -> tuple[float, Array]:
        """Command a pose of the grasp in the palm frame.

        Args:
            position: p_d of the contact centroid, shape (3,), m.
            rotation: Rotation vector, shape (3,), rad; None keeps the grasp's orientation.

        Returns:
            The simulated time from which the pose is the target [s], and its rotation vector.

        Raises:
            ConfigurationError: If a number is not finite.
            SteeringError: If there is no hand, or it rejects the pose.
        """
        _check_finite([*position, *(rotation or ())])
        quaternion = np.full(4, np.nan)
        if rotation is not None:
            quaternion = quaternion_from_rotation(rotation_from_vector(rotation))
        data = PoseCodec(nan_allowed=True).encode(np.array(position), quaternion, 0)
        wanted = deserialize_message(data, PoseStamped)

        def is_ours(message: PoseStamped) -> bool:
            asked, got = wanted.pose, message.pose
            is_turned = rotation is None or got.orientation == asked.orientation
            return bool(is_turned and got.position == asked.position)

        accepted = (PoseStamped, names.ACCEPTED_POSE, is_ours)
        taken = self._send(wanted, names.CONTROLLER, names.DESIRED_POSE, accepted)
        q = taken.pose.orientation
        orientation = rotation_from_quaternion([q.x, q.y, q.z, q.w])
        effective = 1e-9 * Time.from_msg(taken.header.stamp).nanoseconds
        return effective, vector_from_rotation(orientation)

    def grasp_force(self, force: float) -> float:
        """Request a grasp force k_f [N]; return the simulated time at which it takes effect [s].

        Raises the same errors as `move`.
        """
        _check_finite([force])
        accepted = (WrenchStamped, names.ACCEPTED_FORCE, lambda m: m.wrench.force.y == force)
        message = Float64(data=force)
        taken = self._send(message, names.REGULATOR, names.USER_GRASP_FORCE, accepted)
        return 1e-9 * float(Time.from_msg(taken.header.stamp).nanoseconds)

    def grasp(self, close: bool) -> str:
        """Close the fingers until all touch, or open them; return the answer.

        Raise SteeringError if there is no hand, or it rejects the request.
        """
        return self._call(SetBool, f"{names.CONTROLLER}/grasp", SetBool.Request(data=close))

    def reset(self) -> str:
        """Restart: a simulation from its start, a real hand with its present grasp.

        The publisher of joint_states decides which of the two it is. Raise SteeringError if there
        is no hand, or it rejects the request.
        """
        last = f"{names.CONTROLLER}/reset"
        self._wait(self._node.create_client(Trigger, last).service_is_ready, self._absence())
        senders: set[str] = set()

        def is_known() -> bool:
            topic = self._node.resolve_topic_name(names.JOINT_STATES)
            found = self._node.get_publishers_info_by_topic(topic)
            senders.clear()
            senders.update(each.node_name for each in found)
            return bool(senders) and _UNDISCOVERED not in senders

        self._wait(is_known, "joint_states has no publisher; is the hand's driver running?")
        if names.PLANT in senders:
            self._call(Trigger, f"{names.PLANT}/reset", Trigger.Request())
            return "time, hand and object are back at the start"
        self._call(Trigger, f"{names.REGULATOR}/reset", Trigger.Request())
        return self._call(Trigger, last, Trigger.Request())

    def _send(
        self, message: Any, node: str, topic: str, accepted: tuple[Any, str, Callable[[Any], bool]]
    ) -> Any:
        """Send a command to a node and return the message that accepts it."""
        taken: list[Any] = []
        refused: list[DiagnosticArray] = []
        kind, name, is_ours = accepted
        publisher = self._node.create_publisher(type(message), topic, qos.USER_DEPTH)
        hear = self._node.create_subscription
        answers = [
            hear(kind, name, lambda m: taken.append(m) if is_ours(m) else None, qos.USER_DEPTH),
            hear(DiagnosticArray, names.rejected(node), refused.append, qos.USER_DEPTH),
        ]
        self._wait(
            lambda: (
                publisher.get_subscription_count() > 0
                and all(each.get_publisher_count() > 0 for each in answers)
            ),
            self._absence(),
        )
        due = time.monotonic()

        def answered() -> bool:
            # The hand may not have matched our subscriptions yet; then its first answer is lost.
            nonlocal due
            if time.monotonic() >= due:
                publisher.publish(message)
                due = time.monotonic() + _AGAIN
            return bool(taken or refused)

        self._wait(
            answered,
            f"the hand has not answered within {self._timeout:g} s; if it is paused or stopped, it "
            "may still carry out the command when it continues",
        )
        if not taken:
            raise SteeringError(f"the hand rejects the command: {_reason(refused, topic)}")
        return taken[0]

    def _call(self, kind: Any, service: str, request: Any) -> str:
        client = self._node.create_client(kind, service)
        self._wait(client.service_is_ready, self._absence())
        future = client.call_async(request)
        self._wait(future.done, f"{service} has not answered within {self._timeout:g} s")
        answer = future.result()
        if not answer.success:
            raise SteeringError(f"the hand rejects the command: {answer.message}")
        return str(answer.message)

    def _wait(self, condition: Callable[[], bool], problem: str) -> None:
        """Wait for a condition; raise SteeringError with `problem` after the timeout."""
        if not _spin(self._executor, condition, self._timeout):
            raise SteeringError(problem)

    def _absence(self) -> str:
        domain, namespace = self._node.context.get_domain_id(), self._node.get_namespace()
        return (
            f"no hand is running in ROS domain {domain} and namespace '{namespace}'; start one with"
            " `tactile-hand run --interactive`, or give its --namespace or ROS_DOMAIN_ID"
        )


def _check_finite(numbers: Sequence[float]) -> None:
    wrong = [number for number in numbers if not math.isfinite(number)]
    if wrong:
        raise ConfigurationError(f"{wrong[0]} is not a finite number")


def _reason(refused: list[DiagnosticArray], topic: str) -> str:
    """Return why a command on a topic was rejected."""
    found = [p.value for m in refused for s in m.status for p in s.values if p.key == topic]
    return found[0] if found else "no reason given"
