# SPDX-License-Identifier: Apache-2.0
"""What the orchestrator says to the graph: desired poses, squeezes, and go or pause."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from tactile_hand_ros import names
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.messages.wire import PoseCodec
from tactile_hand_ros.ros.node import PUBLICATIONS
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.scenario.scenario import TargetConfig, UserForceConfig

_SLICE = 0.02  # s


class SteeringError(TactileHandError):
    """The graph does not answer."""


class Steering:
    """Publisher of desired poses and squeezes, and client of the plant's ``~/run``."""

    def __init__(self, node: Node, check: Callable[[], None]) -> None:
        """Create publishers and client.

        Args:
            node: A node in the namespace of the run.
            check: Called while waiting; raises to give up.
        """
        self._check = check
        # A queue of one is full with each message, and only with a full queue does Fast DDS ask
        # for the acknowledgement at once; otherwise it asks every 3 s.
        qos = QoSProfile(depth=1)
        self._poses = node.create_publisher(PoseStamped, names.DESIRED_POSE, qos)
        self._squeezes = node.create_publisher(Float64, names.USER_GRASP_FORCE, qos)
        self._client = node.create_client(SetBool, "plant/run")
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    @property
    def is_ready(self) -> bool:
        """Whether the plant's service can be called."""
        return bool(self._client.service_is_ready())

    @property
    def facts(self) -> dict[str, str]:
        """Whom this process has met, as nodes say it in their diagnostics."""
        ours = (self._poses, self._squeezes)
        return {f"{PUBLICATIONS} {p.topic_name}": str(p.get_subscription_count()) for p in ours}

    def command(self, targets: Sequence[TargetConfig], timeout: float = 5.0) -> None:
        """Send desired poses, each with the tick from which it holds, and wait until they arrived.

        Raises:
            SteeringError: If a listener does not acknowledge them.
        """
        for target in targets:
            pose = target.target()
            turn = quaternion_from_rotation(pose.orientation)
            self._poses.publish(PoseCodec().encode(pose.position, turn, target.stamp))
            self._deliver(self._poses, f"the desired pose for t = {target.time} s", timeout)

    def squeeze(self, request: UserForceConfig, timeout: float = 5.0) -> None:
        """Send a squeeze that the user asks for and wait until it arrived.

        Raises:
            SteeringError: If a listener does not acknowledge it.
        """
        self._squeezes.publish(Float64(data=float(request.force)))
        self._deliver(self._squeezes, f"the squeeze for t = {request.time} s", timeout)

    def _deliver(self, publisher: Publisher, what: str, timeout: float) -> None:
        end = time.monotonic() + timeout
        while not publisher.wait_for_all_acked(Duration(seconds=_SLICE)):
            self._check()
            if time.monotonic() > end:
                raise SteeringError(
                    f"{what} was not received by all subscribers within {timeout:g} s; look at "
                    "the logs of the nodes"
                )

    def run(self, on: bool, timeout: float = 5.0, check: bool = True) -> None:
        """Let the plant run or pause.

        Args:
            on: Run or pause.
            timeout: Longest wait for the answer [s].
            check: Whether to give up early when the constructor's `check` says so.

        Raises:
            SteeringError: If the plant refuses or does not answer.
        """
        future = self._client.call_async(SetBool.Request(data=on))
        end = time.monotonic() + timeout
        while not future.done():
            if check:
                self._check()
            if time.monotonic() > end:
                raise SteeringError(f"the plant did not answer to ~/run within {timeout:g} s")
            self._executor.spin_once(timeout_sec=_SLICE)
        answer = future.result()
        if not answer.success:
            raise SteeringError(f"the plant refuses ~/run: {answer.message}")


class UserForces:
    """The squeezes of a scenario, each passed on when simulated time has come to it.

    They carry no stamp, as nothing that a user does by hand: the tick at which one takes effect
    follows from when it is sent and how long it travels, and may differ from run to run.
    """

    def __init__(
        self, requests: Sequence[UserForceConfig], send: Callable[[UserForceConfig], None]
    ) -> None:
        """Say what is asked for and how it is sent."""
        self._waiting = sorted(requests, key=lambda request: request.time)
        self._send = send

    @property
    def is_due_later(self) -> bool:
        """Whether something is left to be sent after the start."""
        return any(each.stamp > 0 for each in self._waiting)

    def step(self, stamp: int) -> None:
        """Send what is due at a tick [ns]: the newest, which replaces those before it."""
        due = [each for each in self._waiting if each.stamp <= stamp]
        self._waiting = self._waiting[len(due) :]
        if due:
            self._send(due[-1])


def how_to_steer(namespace: str) -> str:
    """Return the command that moves the hand from a second terminal."""
    where = "" if namespace == "/" else f" --namespace {namespace}"
    return f"tactile-hand move 0.02 0.06 0.40{where}"
