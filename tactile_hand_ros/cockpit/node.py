# SPDX-License-Identifier: Apache-2.0
"""The node `cockpit`: offers the page, fills its picture, and sends what its user asks for.

It only watches and commands as any user may: no other node depends on it, and if it dies, a push
ends by itself and the hand keeps its target.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import ContentReader
from tactile_hand_ros.cockpit.commands import MOST_FORCE, Commands
from tactile_hand_ros.cockpit.config import LINK, CockpitConfig
from tactile_hand_ros.cockpit.events import Watch
from tactile_hand_ros.cockpit.picture import KEPT, Picture
from tactile_hand_ros.cockpit.server import Reply, Server
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.report import model
from tactile_hand_ros.report.page import live_page
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import described, subscribe_directly, taken
from tactile_hand_ros.ros.messages import PoseCodec, PushCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.relay import PERIOD, unpack_batch
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.scenario.scenario import NODES
from tactile_hand_ros.simulation.plant_run import PUSH_LASTS

_PICTURE_PERIOD = 0.8 * PERIOD  # s, shortest; a batch of each node comes in one period
_STATUS_PERIOD = 0.25  # s between two looks at ages and health
_SILENT = 2.5  # s without diagnostics, which come every second
_EVENTS = 200  # kept
_MOMENTS = 1200  # kept, five minutes of them
_MOST_WAITING = 100  # commands
_SHOWN = ("rate_hz", "latency_p99_us", "late_commands", "mode", "rejected")
_STALE = 3
_NOTHING: dict[str, Any] = {"nodes": [], "margins": {}, "events": [], "response": {}}


class CockpitNode(TactileNode[CockpitConfig]):
    """Offers a page that shows and steers one hand.

    Subscriptions: `_ticks/<node>` (std_msgs/UInt8MultiArray, batches of tick messages) of plant,
    sensor, regulator, optimizer and controller; with `drivers` also `joint_states`,
    `tactile/contacts` and `tactile/<finger>/wrench`, each message; `accepted/desired_pose`, `push`,
    `rejected/<node>`, `robot_description`, `/diagnostics`.

    Publications, only on demand: `desired_pose`, `user_grasp_force`, `push` (geometry_msgs/
    WrenchStamped in `palm`, N and N m), `marks` (std_msgs/String, a user's mark in the recording).
    It calls the services `~/run`, `~/reset`, `~/grasp`, `~/enable` and those of parameters.

    Parameters: the fields of `CockpitConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Subscribe and offer the page; its link is printed.

        Raises:
            TactileHandError: If a parameter is rejected, or the page cannot be offered.
        """
        super().__init__("cockpit", CockpitConfig, **kwargs)
        self._fingers = load_hand_config(self.config.hand)
        self.picture: Picture | None = None
        self.report: Path | None = None
        self._watch, self._events = Watch(), deque[dict[str, Any]](maxlen=_EVENTS)
        self._description, self._number = "", 0
        self._tree: dict[str, Any] | None = None
        self._health: dict[str, dict[str, Any]] = {}
        self._margins: dict[str, str] = {}
        self._epoch, self._due = 0, 0.0
        self._moments = deque[tuple[float, int]](maxlen=_MOMENTS)
        self.status: dict[str, Any] = _NOTHING
        self._direct: dict[str, Any] = {}
        self._subscribe()
        self.commands = Commands(self)
        self._waiting = queue.SimpleQueue[tuple[Mapping[str, Any], Reply]]()
        self._bell = self.create_guard_condition(self.guarded("commands", self._on_commands))
        self.create_timer(_STATUS_PERIOD, self._on_status)
        self._server = Server(
            self, live_page(self.config.name), self.config.address, self.config.port
        )
        print(f"{LINK}{self._server.link}", flush=True)

    def _subscribe(self) -> None:
        user = qos.user_qos()
        for node in NODES:
            topic = names.ticks_of(node)
            self.subscribe(UInt8MultiArray, topic, self._on_batch, profile=user)
        for node in (names.CONTROLLER, names.REGULATOR):
            self.subscribe(DiagnosticArray, names.rejected(node), self._on_rejected_command)
        if self.config.drivers:
            self._subscribe_to_drivers()
        latched = qos.latched_qos()
        self.subscribe(String, names.ROBOT_DESCRIPTION, self._on_description, profile=latched)
        self._decode_pose, self._decode_push = PoseCodec().decode, PushCodec().decode
        self.subscribe(PoseStamped, names.ACCEPTED_POSE, self._on_pose, profile=user, raw=True)
        self.subscribe(WrenchStamped, names.PUSH, self._on_push, profile=user, raw=True)
        self.subscribe(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, profile=user)

    def _subscribe_to_drivers(self) -> None:
        kinds: dict[str, Any] = {names.JOINT_STATES: JointState, names.CONTACTS: PoseArray}
        kinds |= {names.wrench(name): WrenchStamped for name in self._fingers.finger_names}
        # Drivers may publish with best effort, and what is lost here is only not shown.
        profile = QoSProfile(depth=qos.PUBLISHED_DEPTH)
        profile.reliability = QoSReliabilityPolicy.BEST_EFFORT
        for topic, kind in kinds.items():
            self._direct[topic] = subscribe_directly(self, kind, topic, profile)
        self.create_timer(PERIOD, self._on_drivers)

    def _on_drivers(self) -> None:
        self._take({topic: [data for data, _ in taken(s)] for topic, s in self._direct.items()})

    def close(self) -> None:
        """Stop the server and let stopped nodes continue."""
        self.commands.close()
        self._server.close()

    # From the thread of the server.

    def hello(self) -> dict[str, Any]:
        """Return what a tab must know before the first picture."""
        picture, config = self.picture, self.config
        assert picture is not None
        return {
            "name": config.name,
            "fingers": model.fingers(picture.fingers),
            "joints": model.joints(picture.joint_names, picture.fingers, self._tree),
            "hand": self._tree,
            "object": model.solid_of(config.object.solid()),
            "columns": picture.columns,
            "kept": KEPT,
            "push": MOST_FORCE,
            "nodes": NODES,
            "saves": bool(config.bag),
        }

    def submit(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Queue a command for the thread of the node."""
        if self._waiting.qsize() >= _MOST_WAITING:
            reply(False, f"{_MOST_WAITING} commands wait already; send fewer")
            return
        self._waiting.put((command, reply))
        self._bell.trigger()

    def released(self) -> None:
        """Stop pushing when no tab has control any more."""
        self.submit({"do": "push", "wrench": [0.0] * 6}, lambda *_: None)

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
                self.survive("commands", error)

    def _on_batch(self, message: UInt8MultiArray) -> None:
        batch = unpack_batch(message)
        self._take({topic: data for topic, data in batch.items() if topic not in self._direct})

    def _take(self, batch: Mapping[str, Sequence[bytes]]) -> None:
        """Read messages by topic, oldest first, and show what they make complete."""
        if self.picture is None:
            states = batch.get(names.JOINT_STATES)
            if not states or not self._description:
                return
            self._begin(states[0])
        picture = self.picture
        assert picture is not None
        for error in picture.take(batch):
            self.reject("ticks", error)
        if picture.epoch != self._epoch:
            self._epoch, self._watch = picture.epoch, Watch()
            self._events.clear()
            self._moments.clear()
        for event in self._watch.step(picture):
            self._events.append(event | {"id": self._next()})
        self._show()

    def _show(self) -> None:
        """Make new rows, at most one picture for each batch."""
        now = time.monotonic()
        if self.picture and now >= self._due and self.picture.advance():
            self._due = now + _PICTURE_PERIOD
            self._server.notify()

    def _begin(self, data: bytes) -> None:
        """Start with the joints of a first message."""
        found = ContentReader("sensor_msgs/msg/JointState")(data).texts[1:]
        tips = {tip.tip: (tip.name, tip.radius) for tip in self._fingers.fingers}
        self._tree = model.hand_tree(self._description, found, tips)
        self.picture = Picture(self._fingers.finger_names, found)

    def event(self, kind: str, text: str) -> None:
        """Add an event of now."""
        stamp = self.picture.stamp if self.picture else 0
        added = {"time": 1e-9 * stamp, "kind": kind, "finger": "", "text": text}
        self._events.append(added | {"id": self._next()})

    def _next(self) -> int:
        self._number += 1
        return self._number

    def _on_description(self, message: String) -> None:
        self._description = message.data

    def _on_pose(self, data: bytes) -> None:
        _, pose = self._decode_pose(data)
        if self.picture is not None:
            self.picture.desired = np.concatenate([pose.position, pose.quaternion])
        self.event("command", "a new pose is commanded")

    def _on_push(self, data: bytes) -> None:
        stamp, wrench = self._decode_push(data)
        if self.picture is not None:
            self.picture.push = wrench
            self.picture.push_end = (stamp or self.picture.stamp) + PUSH_LASTS

    def _on_rejected_command(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                self.event("refusal", f"{pair.key} is rejected: {pair.value}")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        prefix = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            name = status.name.removeprefix(prefix)
            if not status.name.startswith(prefix) or name == self.get_name():
                continue
            values = {pair.key: pair.value for pair in status.values}
            level = int.from_bytes(status.level, "little")
            self._health[name] = {
                "level": level,
                "message": status.message[:300],
                "pid": values.get("pid", ""),
                "received": time.monotonic(),
                **{key: values[key] for key in _SHOWN if key in values},
            }
            self._margins |= {k: v for k, v in values.items() if k[:1] == "A" and k[1:2].isdigit()}

    def since(self, last: float) -> float:
        """Return how long ago the last seconds of simulated time began, s; 0 for all."""
        if not last or not self._moments or self.picture is None:
            return 0.0
        start = self.picture.stamp - round(1e9 * last)
        earlier = (when for when, stamp in reversed(self._moments) if stamp <= start)
        return time.monotonic() - next(earlier, self._moments[0][0])

    def process_of(self, node: str) -> int | None:
        """Return the process id of a node that shares its process with none."""
        pid = self._health.get(node, {}).get("pid", "")
        shared = [each for each in self._health.values() if each["pid"] == pid]
        return int(pid) if pid.isdigit() and len(shared) == 1 else None

    def _on_status(self) -> None:
        self._show()  # the last rows before a pause
        now, nodes = time.monotonic(), []
        if self.picture is not None:
            self._moments.append((now, self.picture.stamp))
        for name, each in sorted(self._health.items()):
            age = now - each["received"]
            shown = {key: value for key, value in each.items() if key not in ("received", "pid")}
            if silent := age > _SILENT:
                shown |= {"level": _STALE, "message": f"silent for {age:.0f} s"}
            alone = self.process_of(name) is not None
            nodes.append({**shown, "name": name, "silent": silent, "alone": alone})
        status = {
            "nodes": nodes,
            "margins": dict(sorted(self._margins.items())),
            "events": list(self._events)[-_EVENTS:],
            "response": dict(self._watch.response),
            "report": self.report is not None,
        }
        if status != self.status:
            self.status = status
            self._server.notify()
        self.diagnostics.tick()


def main(args: Sequence[str] | None = None) -> int:
    """Run the cockpit until SIGINT or SIGTERM and return the exit code."""
    return run_node(CockpitNode, args)
