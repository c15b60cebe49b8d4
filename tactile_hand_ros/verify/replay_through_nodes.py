# SPDX-License-Identifier: Apache-2.0
"""Recomputation by the real nodes: their processes, their messages, compared byte for byte.

The sensor topics of a bag are published tick by tick in lockstep: the next tick comes when the
controller has answered the last one. A tick that stays unanswered is sent again, which the nodes
take for the same tick.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.config.fields import is_live
from tactile_hand_ros.config.model import Config, leaves
from tactile_hand_ros.control.laws import Target, law_of
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.messages.wire import PoseCodec, stamp_of
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.parameters import to_parameters, to_params_yaml
from tactile_hand_ros.ros.processes import start_executable
from tactile_hand_ros.ros.qos import tick_publisher_qos, tick_qos, user_qos
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import changed
from tactile_hand_ros.verify.recompute import (
    Comparison,
    full_key,
    scenario_of,
)
from tactile_hand_ros.verify.recorded_inputs import (
    CONTROLLERS,
    Effects,
    Inputs,
    Request,
    read_inputs,
)

_PATIENCE = 60.0  # s until the nodes must have answered
_RESEND = 0.2  # s
_ACK = Duration(seconds=5)
Payloads = dict[str, dict[int, bytes]]
"""Bytes by topic and stamp [ns]."""


class NoAnswerError(TactileHandError):
    """Nodes that do not answer."""


def replay_through_nodes(
    run: Run,
    changes: Mapping[str, Any] | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Comparison]:
    """Feed the sensor topics of a run to the real nodes and compare what they publish.

    Args:
        run: The run; its scenario must be known.
        changes: Other values by dotted key.
        progress: Called with the share of the ticks that were answered.

    Raises:
        TactileHandError: If a change is refused, or the nodes do not answer.
    """
    values = {full_key(key): value for key, value in (changes or {}).items()}
    # In lockstep nothing is missing: what is late must be waited for.
    values["manipulation_controller.input_timeout"] = _PATIENCE
    base = scenario_of(run)
    inputs = read_inputs(run, base).changed(base, changed(base, values))
    fingers = run.topics.fingers
    sensors = [names.JOINT_STATES, names.CONTACTS, *(names.wrench(f) for f in fingers)]
    answers = [names.GRASP_FORCE, names.GRIP_STATE, names.AUXILIARY_POSE]
    answers += [*(names.optimal_force(f) for f in fingers), names.JOINT_COMMAND]
    recorded = _payloads(run, [*sensors, *answers])
    stamps = [int(s) for s in inputs.record.stamps if int(s) in recorded[names.JOINT_COMMAND]]
    with _nodes(inputs), _Feeder(sensors, answers) as feeder:
        commands = _Commands(inputs, feeder)
        for count, stamp in enumerate(stamps):
            commands.send(stamp)
            feeder.tick(stamp, {name: recorded[name].get(stamp) for name in sensors})
            progress((count + 1) / len(stamps))
        feeder.settle({name: len(recorded[name].keys() & set(stamps)) for name in answers})
        got = feeder.got
    return [_compare(name, recorded[name], got[name], stamps) for name in answers]


def _payloads(run: Run, wanted: list[str]) -> Payloads:
    """Return the recorded bytes of the last run in a bag, by relative topic."""
    full = {run.topics.full(name): name for name in wanted}
    out: Payloads = {name: {} for name in wanted}
    for topic, _, data in read_raw(run.bag, full):
        out[full[topic]][stamp_of(data)] = data
    return out


@contextmanager
def _nodes(inputs: Inputs) -> Iterator[None]:
    """Run the controllers in a ROS domain of their own.

    Raises:
        ConfigurationError: If the law is code that only the bag names.
    """
    law_of(inputs.configurations[names.CONTROLLER][0].value.law)  # a node would import it
    use_sockets()
    with isolated_domain(), tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        for name in CONTROLLERS:
            file = Path(folder) / f"{name}.yaml"
            config = inputs.configurations[name][0].value
            file.write_text(to_params_yaml(config, name), encoding="utf-8")
            arguments = ("--ros-args", "--params-file", str(file))
            stack.enter_context(start_executable(name, *arguments))
        yield


_TYPES = {names.JOINT_STATES: JointState, names.JOINT_COMMAND: JointState}
_TYPES |= {names.GRIP_STATE: JointState, names.CONTACTS: PoseArray}
_TYPES |= {names.AUXILIARY_POSE: PoseStamped}


class _Feeder:
    """Publishes sensor topics and collects answers."""

    def __init__(self, sensors: list[str], answers: list[str]) -> None:
        self.got: Payloads = {name: {} for name in answers}
        self._names = sensors, answers
        self._stack = ExitStack()

    def __enter__(self) -> _Feeder:
        context = self._stack.enter_context(private_context(int(os.environ["ROS_DOMAIN_ID"])))
        node = self._node = Node("replay_through_nodes", context=context)
        self._stack.callback(node.destroy_node)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        sensors, answers = self._names
        for name in answers:
            keep = partial(self._keep, name)
            node.create_subscription(
                _TYPES.get(name, WrenchStamped), name, keep, tick_qos(), raw=True
            )
        self._publishers: dict[str, Publisher] = {
            name: node.create_publisher(_TYPES.get(name, WrenchStamped), name, tick_publisher_qos())
            for name in sensors
        }
        self._pose = node.create_publisher(PoseStamped, names.DESIRED_POSE, user_qos())
        self._force = node.create_publisher(Float64, names.USER_GRASP_FORCE, user_qos())
        met = [*self._publishers.values(), self._pose, self._force]
        self._until(lambda: all(p.get_subscription_count() for p in met), "to start")
        self._until(
            lambda: all(node.count_publishers(name) for name in answers), "to offer answers"
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _keep(self, name: str, data: bytes) -> None:
        self.got[name][stamp_of(data)] = data

    def _until(self, condition: Callable[[], bool], what: str, limit: float = _PATIENCE) -> None:
        end = time.monotonic() + limit
        while not condition():
            self._executor.spin_once(timeout_sec=0.01)
            if time.monotonic() > end:
                raise NoAnswerError(
                    f"The nodes had {limit:g} s {what} and did not; run them by hand to see why."
                )

    def force(self, force: float) -> None:
        """Request a squeeze [N]; it is there before the next tick is sent."""
        self._force.publish(serialize_message(Float64(data=force)))
        self._force.wait_for_all_acked(_ACK)

    def pose(self, target: Target, stamp: int) -> None:
        """Command a desired pose for a tick [ns]; it is there before the next tick is sent."""
        turn = quaternion_from_rotation(target.orientation)
        self._pose.publish(PoseCodec().encode(target.position, turn, stamp))
        self._pose.wait_for_all_acked(_ACK)

    def configure(self, node: str, config: Config) -> None:
        """Set the live parameters of a node."""
        live = {name for name, field in leaves(type(config)).items() if is_live(field)}
        parameters = [each for each in to_parameters(config) if each.name in live]
        request = SetParametersAtomically.Request(parameters=parameters)
        self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)

    def request(self, node: str, request: Request) -> None:
        """Call a service of a node."""
        name = f"{node}/{request.service}"
        if request.service == "reset":
            self._call(Trigger, name, Trigger.Request())
        else:
            self._call(SetBool, name, SetBool.Request(data=request.value))

    def _call(self, kind: Any, name: str, request: Any) -> None:
        client = self._node.create_client(kind, name)
        self._until(client.service_is_ready, f"to offer {name}")
        future = client.call_async(request)
        self._until(future.done, f"to answer {name}")
        self._node.destroy_client(client)

    def tick(self, stamp: int, messages: Mapping[str, bytes | None]) -> None:
        """Send a tick, again and again if need be, until the controller has answered it."""
        end = time.monotonic() + _PATIENCE
        answered = self.got[names.JOINT_COMMAND]
        while stamp not in answered:
            for name, data in messages.items():
                if data is not None:
                    self._publishers[name].publish(data)
            again = time.monotonic() + _RESEND
            while stamp not in answered and time.monotonic() < again:
                self._executor.spin_once(timeout_sec=0.01)
            if time.monotonic() > end:
                raise NoAnswerError(
                    f"The nodes had {_PATIENCE:g} s to answer tick {stamp} ns and did not; the bag "
                    "may lack a topic that this configuration needs."
                )

    def settle(self, counts: Mapping[str, int]) -> None:
        """Wait for the last answers, as many as were recorded at most for a moment."""
        end = time.monotonic() + 1.0
        while time.monotonic() < end and any(len(self.got[n]) < c for n, c in counts.items()):
            self._executor.spin_once(timeout_sec=0.01)


class _Commands:
    """Sends everything that took effect at a tick just before that tick."""

    def __init__(self, inputs: Inputs, feeder: _Feeder) -> None:
        self._feeder = feeder
        self._configurations = {node: Effects(e) for node, e in inputs.configurations.items()}
        for effects in self._configurations.values():
            effects.first()  # with which the node was started
        self._requests = {node: Effects(e) for node, e in inputs.requests.items()}
        self._forces, self._poses = Effects(inputs.forces), Effects(inputs.poses)

    def send(self, stamp: int) -> None:
        """Send what takes effect at a tick [ns], as the nodes apply it."""
        for node, effects in self._configurations.items():
            for config in effects.until(stamp):
                self._feeder.configure(node, config)
        for node, effects in self._requests.items():
            for request in effects.until(stamp):
                self._feeder.request(node, request)
        for force in self._forces.until(stamp):
            self._feeder.force(force)
        for target in self._poses.until(stamp):
            self._feeder.pose(target, stamp)


def _compare(
    name: str, recorded: Mapping[int, bytes], got: Mapping[int, bytes], stamps: list[int]
) -> Comparison:
    """Compare payloads; `recompute` shows how far apart they are."""
    known = [stamp for stamp in stamps if stamp in recorded or stamp in got]
    wrong = [stamp for stamp in known if recorded.get(stamp) != got.get(stamp)]
    first, same = wrong[0] if wrong else None, len(known) - len(wrong)
    return Comparison(name, "bytes", len(known), same, first, float("nan") if wrong else 0.0)
