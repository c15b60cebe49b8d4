# SPDX-License-Identifier: Apache-2.0
"""The five nodes as processes in their own ROS domain, and a node that steers and watches them."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rcl_interfaces.msg import Parameter, SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter as ParameterValue
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from bench.processes import CapturedProcess, parameter_files, start_executable
from bench.wire import each_tick
from support.messages import pose_message, stamp_to_ns
from support.nodes import spinning
from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS
from tactile_hand_ros.ros.processes import end_together, wait_until
from tactile_hand_ros.scenario.scenario import NODES, Scenario

PATIENCE = 120.0
"""Longest wait for anything [s]; long, because the first start may compile code."""


TICK_TOPICS = [link.topic for link in each_tick()]
"""Topics of the tick of a hand with three fingers."""


class Health(NamedTuple):
    """The last diagnostics of a node."""

    level: bytes
    message: str
    values: dict[str, str]


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


class Graph:
    """The five nodes of one scenario, started together and stopped when the context exits."""

    def __init__(
        self,
        scenario: Scenario,
        domain: int,
        folder: Path,
        namespace: str = "",
        *,
        composed: bool = False,
    ) -> None:
        """Prepare; entering the context starts a process for each node, or one for all."""
        self.scenario = scenario
        self.namespace = namespace
        self._fingers = load_hand_config(scenario.hand).finger_names
        self.health: dict[str, Health] = {}
        self.processes: dict[str, CapturedProcess] = {}
        self._domain, self._folder, self._composed = domain, folder, composed
        self._stack = ExitStack()
        self._newest: dict[str, bytes] = {}
        self._types: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Graph:
        """Start everything and wait until all have matched each other."""
        try:
            for name in ["composed"] if self._composed else NODES:
                self.start(name)
            context = self._stack.enter_context(ros_context(domain=self._domain))
            self.node = Node("watcher", context=context, namespace=self.namespace)
            self._stack.callback(self.node.destroy_node)
            self._talk()
            self._stack.enter_context(spinning(self.node))
            self.wait_for_readers()
            heard = [self.full(name) for name in NODES]
            self.wait(
                lambda: all(all(self._ends(n, SUBSCRIPTIONS).values()) for n in heard), "writers"
            )
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop all processes at the same time."""
        end_together(list(self.processes.values()))
        self._stack.close()

    def start(self, name: str) -> CapturedProcess:
        """Start or restart a node, or `composed`, with the parameters of the scenario."""
        arguments = ["-r", f"__ns:={self.namespace}"] if self.namespace else []
        nodes = NODES if name == "composed" else [name]
        return self._enter(name, *arguments, *parameter_files(self.scenario, self._folder, nodes))

    def _enter(self, executable: str, *arguments: str) -> CapturedProcess:
        process = start_executable(executable, "--ros-args", *arguments)
        self.processes[executable] = self._stack.enter_context(process)
        return process

    def kill(self, name: str) -> None:
        """Kill a node, as in a crash."""
        self.processes[name].send(signal.SIGKILL)
        self.processes[name].wait()
        self.health.pop(self.full(name), None)

    def full(self, name: str) -> str:
        """Return the full name of a node or topic of this hand."""
        return f"{self.namespace}/{name}"

    def _talk(self) -> None:
        make, depth = self.node.create_publisher, qos.USER_DEPTH
        self.poses = make(PoseStamped, names.DESIRED_POSE, depth)
        make(Float64, names.USER_GRASP_FORCE, depth)
        make(WrenchStamped, names.PUSH, depth)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 100)
        self._watch(JointState, names.JOINT_STATES)
        self._watch(PoseStamped, names.OBJECT_POSE)
        self._watch(PoseStamped, names.AUXILIARY_POSE)
        self._watch(WrenchStamped, names.GRASP_FORCE)
        self._watch(PoseArray, names.TRUE_CONTACTS)
        self._wrenches = [names.true_wrench(name) for name in self._fingers]
        for topic in self._wrenches:
            self._watch(WrenchStamped, topic)

    def _watch(self, kind: Any, topic: str) -> None:
        """Keep the newest message; raw, so that watching costs almost nothing."""
        self._types[topic] = kind

        def keep(data: bytes) -> None:
            self._newest[topic] = data

        self.node.create_subscription(kind, topic, keep, qos.TICK_DEPTH, raw=True)

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.health[status.name] = Health(status.level, status.message, values)

    def wait_for_readers(self) -> None:
        """Wait until every topic of this hand has matched all its subscribers."""
        self.wait(self._has_readers, "all readers")

    def _has_readers(self) -> bool:
        wanted = Counter(each.topic_name for each in self.node.subscriptions)
        for name in list(self.health):
            wanted.update(self._ends(name, SUBSCRIPTIONS).keys())
        ends = [self._ends(self.full(name), PUBLICATIONS) for name in NODES]
        found = {topic: n for end in ends for topic, n in end.items() if topic not in names.OF_ALL}
        return all(ends) and all(count == wanted[topic] for topic, count in found.items())

    def _ends(self, name: str, end: str) -> dict[str, int]:
        """Return the number of matched peers of a node by topic."""
        health = self.health.get(name)
        counts = health.values if health else {}
        return {k.split()[1]: int(v) for k, v in counts.items() if k.startswith(f"{end} ")}

    def hears(self, name: str, topic: str) -> bool:
        """Return whether a node's subscription has matched a publisher."""
        return self._ends(self.full(name), SUBSCRIPTIONS).get(self.full(topic), 0) >= 1

    def is_heard(self, name: str, topic: str) -> bool:
        """Return whether a node's publisher has matched a subscription."""
        return self._ends(self.full(name), PUBLICATIONS).get(self.full(topic), 0) >= 1

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait for a condition; all processes that were not killed must stay alive."""

        def holds() -> Any:
            for name, process in self.processes.items():
                assert process.returncode in (None, -signal.SIGKILL), (name, process.stderr)
            return condition()

        try:
            return wait_until(holds, PATIENCE, what)
        except TimeoutError as error:
            raise TimeoutError(f"{error}; {self.health}") from None

    def newest(self, topic: str) -> Any:
        """Return the newest message of a watched topic."""
        data = self.wait(lambda: self._newest.get(topic), f"a message on {topic}")
        return deserialize_message(data, self._types[topic])

    @property
    def time(self) -> float:
        """Simulated time of the newest tick [s]."""
        return 1e-9 * stamp_to_ns(self.newest(names.JOINT_STATES).header.stamp)

    def position(self) -> Array:
        """Return the position of the object, shape (3,), m."""
        return np.array(_xyz(self.newest(names.OBJECT_POSE).pose.position))

    @property
    def contacts(self) -> Array:
        """True contact points, shape (k, 3), m; NaN where a finger does not touch."""
        return np.array([_xyz(pose.position) for pose in self.newest(names.TRUE_CONTACTS).poses])

    @property
    def forces(self) -> Array:
        """True contact forces, shape (k, 3), N."""
        return np.array([_xyz(self.newest(topic).wrench.force) for topic in self._wrenches])

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service of the hand and return its response."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.wait(client.service_is_ready, service)
        future = client.call_async(request)
        self.wait(future.done, f"an answer of {service}")
        return future.result()

    def run(self, on: bool = True) -> None:
        """Let the plant run or pause."""
        assert self.call(SetBool, "plant/run", SetBool.Request(data=on)).success

    def desire(self, position: Any) -> None:
        """Command a desired pose without rotation."""
        self.poses.publish(pose_message(position, np.eye(3), 0))

    def begin(self, *positions: Any) -> None:
        """Restart at timestamp 0, with desired poses that arrive before the first tick."""
        self.run(False)
        assert self.call(Trigger, "plant/reset", Trigger.Request()).success
        self.wait(lambda: self.says("plant", "mode", "paused"), "the plant at its start")
        for position in positions:
            self.desire(position)
        self._newest.clear()
        self.run()

    def finish(self) -> Health:
        """Wait for the end of the run and return the plant's diagnostics."""
        self.wait(lambda: self.says("plant", "mode", "finished"), "the end of the run")
        return self.health[self.full("plant")]

    def says(self, name: str, key: str, value: str) -> bool:
        """Return whether the last diagnostics of a node contain a value."""
        health = self.health.get(self.full(name))
        return health is not None and health.values.get(key) == value

    def rejected(self, name: str, topic: str) -> int:
        """Return how many messages on a topic a node reports as rejected."""
        health = self.health.get(self.full(name))
        return int(health.values.get(f"rejected {topic}", 0)) if health else 0

    def set_parameter(self, name: str, parameter: str, value: Any) -> SetParametersResult:
        """Set a parameter of a node and return the node's verdict."""
        given = ParameterValue(parameter, value=value).get_parameter_value()
        message = Parameter(name=parameter, value=given)
        request = SetParameters.Request(parameters=[message])
        return self.call(SetParameters, f"{name}/set_parameters", request).results[0]

    def end(self, number: signal.Signals) -> dict[str, int]:
        """Send a signal to every node and return the exit codes."""
        for process in self.processes.values():
            process.send(number)
        return {name: process.wait() for name, process in self.processes.items()}
