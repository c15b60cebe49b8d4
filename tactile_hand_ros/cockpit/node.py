# SPDX-License-Identifier: Apache-2.0
"""The node `cockpit`: offers the page, fills its picture, and sends what its user asks for.

It only watches and commands as any user may: no other node depends on it, and if it crashes, a push
times out and the hand keeps its target.
"""

from __future__ import annotations

import itertools
import queue
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import ContentReader, header_stamp, packed, unpacked
from tactile_hand_ros.cockpit.commands import MOST_FORCE, Commands
from tactile_hand_ros.cockpit.config import LINK, CockpitConfig
from tactile_hand_ros.cockpit.events import Watch
from tactile_hand_ros.cockpit.picture import KEPT, Picture
from tactile_hand_ros.cockpit.server import Reply, Server
from tactile_hand_ros.config.explanation import choices_of, element_type
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.report import model
from tactile_hand_ros.report.page import live_page
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import described, subscribe_directly, taken
from tactile_hand_ros.ros.messages import PoseCodec, PushCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.relay import PERIOD, batch_by_topic
from tactile_hand_ros.scenario.scenario import NODES
from tactile_hand_ros.simulation.plant_run import PUSH_LASTS
from tactile_hand_ros.simulation.skin import TactileSensorConfig

_STATUS_PERIOD = 0.25  # s between two looks at ages and health
_SILENT = 2.5  # s without diagnostics, which come every second
_EVENTS = 200  # kept
_SHOWN = ("rate_hz", "latency_p99_us", "late_commands", "mode")
_STALE = 3


class CockpitNode(TactileNode[CockpitConfig]):
    """Offers a page that shows and steers one hand.

    Subscriptions: `_ticks/<node>` (std_msgs/UInt8MultiArray, batches of tick messages) of plant,
    sensor, regulator, optimizer and controller; with `drivers` also `joint_states`,
    `tactile/contacts` and `tactile/<finger>/wrench`, each message; `accepted/desired_pose`, `push`,
    `rejected/<node>`, `robot_description`, `/diagnostics`.

    Publications, only on demand: `desired_pose`, `user_grasp_force`, `push` (geometry_msgs/
    WrenchStamped in `palm`, N and N m), `marks` (std_msgs/String, a user's mark in the recording).
    It calls the services `plant/run`, `plant/step`, `plant/reset`, `manipulation_controller/grasp`,
    `manipulation_controller/enable` and those of parameters.

    Parameters: the fields of `CockpitConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Subscribe and offer the page; its link is printed.

        Raises:
            TactileHandError: If a parameter is rejected, or the page cannot be offered.
        """
        super().__init__("cockpit", CockpitConfig, **kwargs)
        self._hand = load_hand_config(self.config.hand)
        self.picture = Picture(self._hand.finger_names, (), -1)
        self.report: Path | None = None
        self._watch, self._events = Watch(), deque[dict[str, Any]](maxlen=_EVENTS)
        self._numbers = itertools.count(1)
        self._description, self._tree = "", dict[str, Any]()
        self._health: dict[str, dict[str, Any]] = {}
        self._alive: dict[str, tuple[float, str]] = {}
        self._margins: dict[str, str] = {}
        self._direct: dict[str, Any] = {}
        self._subscribe()
        self.commands = Commands(self)
        self._waiting = queue.SimpleQueue[tuple[Mapping[str, Any], Reply]]()
        self._read_batch = self.guarded("ticks", self._on_batch)
        self._bell = self.create_guard_condition(self.guarded("commands", self._on_commands))
        self.create_timer(PERIOD, self._on_picture)
        self.create_timer(_STATUS_PERIOD, self._on_status)
        self._on_status()
        self._server = Server(self, live_page(self.config.name), self.config.port)
        print(f"{LINK}{self._server.link}", flush=True)

    def _subscribe(self) -> None:
        user, latched = qos.USER_DEPTH, qos.latched_qos()
        topics = map(names.ticks_of, NODES)
        self._batches = [subscribe_directly(self, UInt8MultiArray, each, user) for each in topics]
        for node in (names.CONTROLLER, names.REGULATOR):
            self.subscribe(DiagnosticArray, names.rejected(node), self._on_rejected_command)
        if self.config.drivers:
            self._subscribe_to_drivers()
        self._decode_pose, self._decode_push = PoseCodec().decode, PushCodec().decode
        self.subscribe(String, names.ROBOT_DESCRIPTION, self._on_description, profile=latched)
        self.subscribe(PoseStamped, names.ACCEPTED_POSE, self._on_pose, profile=user, raw=True)
        self.subscribe(WrenchStamped, names.PUSH, self._on_push, profile=user, raw=True)
        self.subscribe(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, profile=user)

    def _subscribe_to_drivers(self) -> None:
        kinds: dict[str, Any] = {names.JOINT_STATES: JointState, names.CONTACTS: PoseArray}
        kinds |= {names.wrench(name): WrenchStamped for name in self._hand.finger_names}
        # Drivers may publish with best effort, and what is lost here is only not shown.
        profile = QoSProfile(depth=qos.PUBLISHED_DEPTH)
        profile.reliability = QoSReliabilityPolicy.BEST_EFFORT
        for topic, kind in kinds.items():
            self._direct[topic] = subscribe_directly(self, kind, topic, profile)

    def close(self) -> None:
        """Let stopped nodes continue."""
        self.commands.close()

    # From the thread of the server.

    def hello(self) -> dict[str, Any]:
        """Return what a tab must know before the first picture."""
        picture, faults = self.picture, TactileSensorConfig.model_fields["faults"]
        return {
            "fingers": model.fingers(picture.fingers),
            "joints": model.joints(picture.joint_names, picture.fingers, self._tree),
            "hand": self._tree,
            "object": model.solid_of(self.config.object.solid()),
            "columns": picture.columns,
            "kept": KEPT,
            "push": MOST_FORCE,
            "faults": choices_of(element_type(faults.annotation)),
            "nodes": NODES,
            "saves": bool(self.config.bag),
        }

    def submit(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Queue a command for the thread of the node."""
        self._waiting.put((command, reply))
        self._bell.trigger()

    # From the executor.

    def _on_commands(self) -> None:
        while not self._waiting.empty():
            command, reply = self._waiting.get()
            try:
                self.commands.carry_out(command, reply)
            except TactileHandError as error:
                reply(False, str(error))
            except Exception as error:
                reply(False, described(error))

    def _on_batch(self, data: bytes) -> None:
        batch = batch_by_topic(data)
        self._take({topic: each for topic, each in batch.items() if topic not in self._direct})

    def _on_picture(self) -> None:
        """Read what has come, and make rows of what is complete."""
        for source in self._batches:
            for data, _ in taken(source):
                self._read_batch(data)
        direct = self._direct.items()
        self._take({topic: packed(data for data, _ in taken(each)) for topic, each in direct})
        if self.picture.advance():
            for stamp, kind, finger, text in self._watch.step(self.picture):
                self.event(kind, text, finger, stamp)

    def _take(self, batch: Mapping[str, bytes]) -> None:
        """Read `packed` messages by topic, oldest first."""
        is_new = self.picture.epoch < 0 and bool(self._description)
        for newest in unpacked(batch.get(names.JOINT_STATES, b""))[-1:]:
            if is_new or header_stamp(newest) < self.picture.stamp:
                self._begin(newest)
        if self.picture.epoch >= 0:
            for error in self.picture.take(batch):
                self.reject("ticks", error)

    def _begin(self, data: bytes) -> None:
        """Start a picture with the joints of a message."""
        joints = ContentReader("sensor_msgs/msg/JointState")(data).texts[1:]
        self._tree = model.hand_tree(self._description, joints, self._hand)
        self._watch = Watch()
        self._events.clear()
        self._on_status()  # before the picture, which would else come with old events
        before = self.picture
        self.picture = Picture(self._hand.finger_names, joints, before.epoch + 1)
        if before.epoch < 0:  # the first target may come before the first ticks
            self.picture.desired = before.desired

    def event(self, kind: str, text: str, finger: str = "", stamp: int | None = None) -> None:
        """Add an event of a tick, ns, or of now."""
        when = 1e-9 * (self.picture.stamp if stamp is None else stamp)
        event = {"time": when, "kind": kind, "finger": finger, "text": text}
        self._events.append(event | {"id": next(self._numbers)})

    def _on_description(self, message: String) -> None:
        self._description = message.data

    def _on_pose(self, data: bytes) -> None:
        _, pose = self._decode_pose(data)
        self.picture.desired = np.concatenate([pose.position, pose.quaternion])
        self.event("command", "a new pose is commanded")

    def _on_push(self, data: bytes) -> None:
        stamp, self.picture.push = self._decode_push(data)
        self.picture.push_end = (stamp or self.picture.stamp) + PUSH_LASTS

    def _on_rejected_command(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                self.event("refusal", f"{pair.key} is rejected: {pair.value}")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            prefix, _, name = status.name.rpartition("/")
            if prefix != self.get_namespace().rstrip("/") or name == self.get_name():
                continue
            values = {pair.key: pair.value for pair in status.values}
            self._health[name] = {
                "name": name,
                "level": int.from_bytes(status.level, "little"),
                "message": status.message[:300],
                **{key: values[key] for key in _SHOWN if key in values},
            }
            self._alive[name] = time.monotonic(), values.get("pid", "")
            self._margins |= {k: v for k, v in values.items() if k[:1] == "A" and k[1:2].isdigit()}

    def process_of(self, node: str) -> int | None:
        """Return the process id of a node that shares its process with none."""
        pids = [pid for _, pid in self._alive.values()]
        _, pid = self._alive.get(node, (0.0, ""))
        return int(pid) if pid.isdigit() and pids.count(pid) == 1 else None

    def _on_status(self) -> None:
        """Update what a tab shows besides the picture."""
        now, nodes = time.monotonic(), []
        for name, health in sorted(self._health.items()):
            age, alone = now - self._alive[name][0], self.process_of(name) is not None
            node = health | {"silent": age > _SILENT, "alone": alone}
            if node["silent"]:
                node |= {"level": _STALE, "message": f"silent for {age:.0f} s"}
            nodes.append(node)
        self.status = {
            "nodes": nodes,
            "margins": dict(sorted(self._margins.items())),
            "events": list(self._events),
            "response": dict(self._watch.response),
            "report": self.report is not None,
        }
