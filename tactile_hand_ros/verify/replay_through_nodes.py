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
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.closed_loop.scenario import Scenario, changed
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.messages.wire import PoseCodec, stamp_of
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.ros.processes import start_executable
from tactile_hand_ros.ros.qos import tick_publisher_qos, tick_qos, user_qos
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify.recompute import (
    CONTROLLERS,
    Comparison,
    full_key,
    heeded_inputs,
    scenario_of,
)
from tactile_hand_ros.verify.recorded_inputs import USER_FORCE, UserCommand

_PATIENCE = 60.0  # s until the nodes must have answered
_RESEND = 0.2  # s
_ACK = Duration(seconds=5)
Payloads = dict[str, dict[int, bytes]]
"""Bytes by topic and stamp [ns]."""


class QuestionError(TactileHandError):
    """Nodes that do not answer."""


def ask_nodes(
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
    scenario = changed(scenario_of(run), values)
    inputs = heeded_inputs(run)
    fingers = run.topics.fingers
    sensors = [names.JOINT_STATES, names.CONTACTS, *(names.wrench(f) for f in fingers)]
    answers = [names.GRASP_FORCE, names.GRIP_STATE, names.AUXILIARY_POSE]
    answers += [*(names.optimal_force(f) for f in fingers), names.JOINT_COMMAND]
    recorded = _payloads(run, [*sensors, *answers])
    stamps = [int(s) for s in inputs.record.stamps if int(s) in recorded[names.JOINT_COMMAND]]
    with _nodes(scenario), _Feeder(sensors, answers) as feeder:
        wishes = sorted([*inputs.poses, *inputs.forces], key=lambda wish: wish.first)
        rows = {int(stamp): row for row, stamp in enumerate(inputs.record.stamps)}
        for count, stamp in enumerate(stamps):
            while wishes and wishes[0].first <= rows[stamp]:
                feeder.wish(wishes.pop(0))
            feeder.ask(stamp, {name: recorded[name].get(stamp) for name in sensors})
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
def _nodes(scenario: Scenario) -> Iterator[None]:
    """Run the controllers in a ROS domain of their own."""
    use_sockets()
    with isolated_domain(), tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        for name in CONTROLLERS:
            file = Path(folder) / f"{name}.yaml"
            file.write_text(to_params_yaml(scenario.node_config(name), name), encoding="utf-8")
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
        node = Node("question", context=context)
        self._stack.callback(node.destroy_node)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        sensors, answers = self._names
        for name in answers:
            heard = partial(self._hear, name)
            node.create_subscription(
                _TYPES.get(name, WrenchStamped), name, heard, tick_qos(), raw=True
            )
        self._publishers: dict[str, Publisher] = {
            name: node.create_publisher(_TYPES.get(name, WrenchStamped), name, tick_publisher_qos())
            for name in sensors
        }
        self._pose = node.create_publisher(PoseStamped, names.DESIRED_POSE, user_qos())
        self._force = node.create_publisher(Float64, USER_FORCE, user_qos())
        met = [*self._publishers.values(), self._pose, self._force]
        self._until(lambda: all(p.get_subscription_count() for p in met), "to start")
        self._until(
            lambda: all(node.count_publishers(name) for name in answers), "to offer answers"
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _hear(self, name: str, data: bytes) -> None:
        self.got[name][stamp_of(data)] = data

    def _until(self, condition: Callable[[], bool], what: str, limit: float = _PATIENCE) -> None:
        end = time.monotonic() + limit
        while not condition():
            self._executor.spin_once(timeout_sec=0.01)
            if time.monotonic() > end:
                raise QuestionError(
                    f"The nodes had {limit:g} s {what} and did not; run them by hand to see why."
                )

    def wish(self, wish: UserCommand) -> None:
        """Send what a user asked for; it is there before the next tick is sent."""
        if isinstance(wish.value, float):
            self._force.publish(serialize_message(Float64(data=wish.value)))
            self._force.wait_for_all_acked(_ACK)
            return
        turn = quaternion_from_rotation(wish.value.orientation)
        self._pose.publish(PoseCodec().encode(wish.value.position, turn, wish.stamp))
        self._pose.wait_for_all_acked(_ACK)

    def ask(self, stamp: int, messages: Mapping[str, bytes | None]) -> None:
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
                raise QuestionError(
                    f"The nodes had {_PATIENCE:g} s to answer tick {stamp} ns and did not; the bag "
                    "may lack a topic that this configuration needs."
                )

    def settle(self, counts: Mapping[str, int]) -> None:
        """Wait for the last answers, as many as were recorded at most for a moment."""
        end = time.monotonic() + 1.0
        while time.monotonic() < end and any(len(self.got[n]) < c for n, c in counts.items()):
            self._executor.spin_once(timeout_sec=0.01)


def _compare(
    name: str, recorded: Mapping[int, bytes], got: Mapping[int, bytes], stamps: list[int]
) -> Comparison:
    """Compare payloads; how far apart they are is for the other comparison to say."""
    known = [stamp for stamp in stamps if stamp in recorded or stamp in got]
    wrong = [stamp for stamp in known if recorded.get(stamp) != got.get(stamp)]
    first, same = wrong[0] if wrong else None, len(known) - len(wrong)
    return Comparison(name, "bytes", len(known), same, first, float("nan") if wrong else 0.0)
