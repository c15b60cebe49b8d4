# SPDX-License-Identifier: Apache-2.0
"""The nodes of a hand as processes, controlled and observed from outside."""

from __future__ import annotations

import bisect
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

from bench.processes import (
    CapturedProcess,
    isolated_domain,
    parameter_files,
    start_executable,
)
from tactile_hand_ros import names
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR
from tactile_hand_ros.ros.executor import WaitSetExecutor
from tactile_hand_ros.ros.messages import ContactsCodec, PoseCodec, WrenchCodec
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.node import SUBSCRIPTIONS
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import NODES, Scenario

PATIENCE = 180.0
"""Maximum wait for the nodes of a session [s]."""

_ANSWER = 20.0  # s, maximum wait for a service
_AGAIN = 5.0  # s without an answer after which a service is called again


class Received(NamedTuple):
    """A received message: monotonic time [s], topic and bytes."""

    time: float
    topic: str
    data: bytes


class RunningHand:
    """The nodes of one scenario in their own domain; they end with the block.

    Attributes:
        processes: The processes by name of the executable.
        events: All messages received since the start of the run.
    """

    def __init__(
        self, scenario: Scenario, folder: Path, *, composed: bool, recorded: bool = True
    ) -> None:
        """Prepare the nodes, in one process if `composed`; entering the block starts them."""
        self.scenario, self._folder = scenario, folder
        self.composed, self._recorded = composed, recorded
        self.fingers = load_hand_config(scenario.hand).finger_names
        self.processes: dict[str, CapturedProcess] = {}
        self.events: list[Received] = []
        self._stack = ExitStack()
        self._clients: dict[str, Any] = {}
        self._types: dict[str, Any] = {}

    def __enter__(self) -> RunningHand:
        """Start all processes and wait until the nodes are connected."""
        try:
            domain = self._stack.enter_context(isolated_domain())
            if self._recorded:
                self.start(names.RECORDER)
            if self.composed:
                self.start(names.COMPOSED, NODES)
            for name in () if self.composed else NODES:
                self.start(name)
            context = self._stack.enter_context(ros_context(domain=domain))
            self.node = Node("campaign", context=context)
            self._stack.callback(self.node.destroy_node)
            self._listen()
            executor = WaitSetExecutor(context=context)
            executor.add_node(self.node)
            thread = threading.Thread(target=executor.spin)
            thread.start()
            self._stack.callback(thread.join)
            self._stack.callback(executor.shutdown)
            self._await_readiness()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self._stack.close()

    def start(self, executable: str, nodes: Sequence[str] = ()) -> None:
        """Start a node, or several nodes in one process, or start it again."""
        arguments = ["-p", f"output:={self._folder}/bag"]
        if executable != names.RECORDER:
            arguments = parameter_files(self.scenario, self._folder, nodes or (executable,))
        process = start_executable(executable, "--ros-args", *arguments)
        self.processes[executable] = self._stack.enter_context(process)

    def _listen(self) -> None:
        make, depth = self.node.create_publisher, qos.USER_DEPTH
        self.poses = make(PoseStamped, names.DESIRED_POSE, depth)
        self.grasp_forces = make(Float64, names.USER_GRASP_FORCE, depth)
        make(WrenchStamped, names.PUSH, depth)  # unused, but the plant waits for its user
        self._subscribe(PoseStamped, names.OBJECT_POSE)
        self._subscribe(PoseArray, names.TRUE_CONTACTS)
        self._subscribe(PoseStamped, names.AUXILIARY_POSE)
        for name in self.fingers:
            self._subscribe(WrenchStamped, names.true_wrench(name))
        self._subscribe(JointState, names.JOINT_COMMAND)
        self._subscribe(Bool, names.JOINT_HOLD, qos.latched_qos())
        self._subscribe(DiagnosticArray, names.DIAGNOSTICS, depth)

    def _subscribe(self, kind: Any, topic: str, profile: Any = qos.TICK_DEPTH) -> None:
        self._types[topic] = kind

        def keep(data: bytes) -> None:
            self.events.append(Received(time.monotonic(), topic, data))

        self.node.create_subscription(kind, topic, keep, profile, raw=True)

    def _await_readiness(self) -> None:
        """Wait until all subscriptions of all nodes are matched."""
        matched: dict[str, bool] = {}
        read = 0

        def met() -> bool:
            nonlocal read
            new = self.events[read:]
            read += len(new)
            told = (event for event in new if event.topic == names.DIAGNOSTICS)
            for status in (each for event in told for each in self.read(event).status):
                counts = (p.value for p in status.values if p.key.startswith(f"{SUBSCRIPTIONS} "))
                matched[status.name.removeprefix("/")] = all(map(int, counts))
            return all(matched.get(name) for name in NODES)

        wait_until(met, PATIENCE, "matched subscriptions of all nodes")

    def since(self, moment: float) -> list[Received]:
        """Return the events after a moment of the monotonic clock [s]."""
        return self.events[bisect.bisect_left(self.events, (moment,)) :]

    def read(self, event: Received) -> Any:
        """Return the message of an event."""
        return deserialize_message(event.data, self._types[event.topic])

    def _call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service until it answers.

        A killed server is still discovered for 20 s. Until the client has matched its successor,
        requests go to the killed server only.
        """
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        wait_until(client.service_is_ready, PATIENCE, f"the service {service}")
        asked: list[Any] = []
        begin = time.monotonic()

        def answer() -> Any:
            if time.monotonic() >= begin + len(asked) * _AGAIN:
                asked.append(client.call_async(request))
            return next((future for future in asked if future.done()), None)

        return wait_until(answer, _ANSWER, f"an answer of {service}").result()

    def begin(self) -> None:
        """Restart at timestamp 0, with the targets of the scenario.

        The events begin with the first tick: on a busy computer, messages of the last run are still
        on their way when the next one starts.
        """
        self._call(SetBool, "plant/run", SetBool.Request(data=False))
        self._call(Trigger, "plant/reset", Trigger.Request())
        self._call(Trigger, "manipulation_controller/reset", Trigger.Request())
        self._call(Trigger, "slip_regulator/reset", Trigger.Request())
        codec = PoseCodec(nan_allowed=True)
        for target in self.scenario.targets:
            pose = target.target()
            self.poses.publish(codec.encode(pose.position, pose.quaternion, target.stamp))
        self.events.clear()
        self._call(SetBool, "plant/run", SetBool.Request(data=True))

        def first_tick() -> Received | None:
            poses = (event for event in self.events if event.topic == names.OBJECT_POSE)
            return next((pose for pose in poses if header_stamp(pose.data) == 0), None)

        first = wait_until(first_tick, PATIENCE, "the first tick")
        del self.events[: self.events.index(first)]

    def wait_for_time(self, seconds: float, limit: float = PATIENCE) -> None:
        """Wait until a simulated time [s], at most for a limit [s]."""
        due = round(1e9 * seconds)

        def is_there() -> bool:
            for event in reversed(self.events):
                if event.topic == names.OBJECT_POSE:
                    return header_stamp(event.data) >= due
            return False

        wait_until(is_there, limit, f"t = {seconds:g} s")

    def positions(self, events: list[Received]) -> tuple[Array, Array]:
        """Return times [s] and positions of the object, shape (n, 3), m."""
        seen = [event for event in events if event.topic == names.OBJECT_POSE]
        points = [self.read(event).pose.position for event in seen]
        where = np.array([[p.x, p.y, p.z] for p in points]).reshape(-1, 3)
        return np.array([event.time for event in seen]), where

    def is_touching(self, events: list[Received]) -> bool:
        """Return whether all fingers touch in the last message of contacts."""
        for event in reversed(events):
            if event.topic == names.TRUE_CONTACTS:
                contacts = ContactsCodec(len(self.fingers)).decode(event.data)[1]
                return bool(np.isfinite(contacts.position).all())
        return False

    def grasp_force(self, events: list[Received]) -> float:
        """Return the largest sum of normal forces of a tick [N]."""
        topics = [names.true_wrench(name) for name in self.fingers]
        sums: dict[bytes, list[float]] = {}
        for event in events:
            if event.topic in topics:
                _, force = WrenchCodec(names.PALM_FRAME, any_frame=True).decode(event.data)
                sums.setdefault(event.data[4:12], []).append(float(force[1]))
        return max((sum(each) for each in sums.values() if len(each) == len(topics)), default=0.0)

    def errors(self, events: list[Received]) -> list[tuple[float, str]]:
        """Return time [s] and text of the nodes' ERRORs."""
        found = []
        for event in events:
            if event.topic == names.DIAGNOSTICS:
                for status in self.read(event).status:
                    if status.level == ERROR:
                        found.append((event.time, f"{status.name}: {status.message}"))
        return found
