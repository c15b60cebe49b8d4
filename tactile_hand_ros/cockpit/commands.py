# SPDX-License-Identifier: Apache-2.0
"""Commands of a page to the hand, by the topics, services and parameters that everybody has."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.cockpit.server import Reply
from tactile_hand_ros.config.explanation import bound_of, choices_of, is_live, unit_of
from tactile_hand_ros.config.model import leaves
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec, PushCodec
from tactile_hand_ros.ros.parameters import ros_type, to_parameter
from tactile_hand_ros.ros.processes import PACKAGE
from tactile_hand_ros.scenario.scenario import NODES, Scenario

MOST_FORCE = 30.0
"""Largest force of a push [N]: what a hand on the object could do with ease."""

_CALLS = {
    "run": (SetBool, names.PLANT, "run", True),
    "pause": (SetBool, names.PLANT, "run", False),
    "step": (Trigger, names.PLANT, "step", None),
    "reset": (Trigger, names.PLANT, "reset", None),
    "grasp": (SetBool, names.CONTROLLER, "grasp", True),
    "release": (SetBool, names.CONTROLLER, "grasp", False),
    "enable": (SetBool, names.CONTROLLER, "enable", True),
    "disable": (SetBool, names.CONTROLLER, "enable", False),
}
_SIGNALS = {"stop": signal.SIGSTOP, "continue": signal.SIGCONT}
_STALL = 0.1  # s for which `stall` stops a node
_CASTS: dict[str, Callable[[Any], Any]] = {
    "DOUBLE": float,
    "INTEGER": int,
    "STRING": str,
    "BOOL": bool,
    "DOUBLE_ARRAY": lambda given: [float(number) for number in given],
    "STRING_ARRAY": lambda given: [str(word) for word in given],
}


class CommandError(TactileHandError):
    """A command that cannot be carried out."""


def live_parameters() -> dict[str, dict[str, Any]]:
    """Return the fields that may change during a run, by node."""
    models: dict[str, Any] = {node: Scenario.model_fields[node].annotation for node in NODES}
    return {
        node: {name: field for name, field in leaves(model).items() if is_live(field)}
        for node, model in models.items()
    }


class Commands:
    """Carries out the commands of the tab in control; called from the executor of the node."""

    def __init__(self, node: Any) -> None:
        """Create publishers and clients; `node` is the cockpit."""
        self._node = node
        make, profile = node.create_publisher, qos.user_qos()
        self._pose = make(PoseStamped, names.DESIRED_POSE, profile)
        self._force = make(Float64, names.USER_GRASP_FORCE, profile)
        self._push = make(WrenchStamped, names.PUSH, profile)
        self._marks = make(String, "marks", profile)
        self._encode_pose, self._encode_push = (
            PoseCodec(nan_allowed=True).encode,
            PushCodec().encode,
        )
        self._fields = live_parameters()
        self._stopped: set[int] = set()
        services = {f"{owner}/{name}": kind for kind, owner, name, _ in _CALLS.values()}
        for owner in self._fields:
            services[f"{owner}/set_parameters"] = SetParameters
            services[f"{owner}/get_parameters"] = GetParameters
        # Created before they are needed, so that they are matched by then.
        self._clients = {name: node.create_client(kind, name) for name, kind in services.items()}

    def carry_out(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Carry out a command and reply, immediately or when the hand has answered.

        Raises:
            CommandError: If it cannot be carried out.
        """
        what = command.get("do")
        if what in _CALLS:
            self._call(*_CALLS[what], reply)
            return
        act: Callable[[Mapping[str, Any], Reply], None] | None
        act = getattr(self, f"_do_{what}", None) if isinstance(what, str) else None
        if act is None:
            raise CommandError(f"'{str(what)[:40]}' is not a command")
        act(command, reply)

    def _do_pose(self, command: Mapping[str, Any], reply: Reply) -> None:
        position = _numbers(command, "position", 3)
        quaternion = np.full(4, np.nan)
        if command.get("quaternion") is not None:
            quaternion = _numbers(command, "quaternion", 4)
            size = float(np.linalg.norm(quaternion))
            if size < 0.5:
                raise CommandError("quaternion has no direction")
            quaternion = quaternion / size
        self._needs(self._pose, names.CONTROLLER)
        self._pose.publish(self._encode_pose(position, quaternion, 0))
        reply(True, "")

    def _do_force(self, command: Mapping[str, Any], reply: Reply) -> None:
        (force,) = _numbers(command, "value", 1)
        self._needs(self._force, names.REGULATOR)
        self._force.publish(Float64(data=float(force)))
        reply(True, "")

    def _do_push(self, command: Mapping[str, Any], reply: Reply) -> None:
        wrench = _numbers(command, "wrench", 6)
        if np.linalg.norm(wrench[:3]) > MOST_FORCE * 1.001:
            raise CommandError(f"a push of at most {MOST_FORCE:g} N is possible")
        self._needs(self._push, names.PLANT)
        picture = self._node.picture
        self._push.publish(self._encode_push(wrench, picture.stamp if picture else 0))
        reply(True, "")

    def _do_mark(self, command: Mapping[str, Any], reply: Reply) -> None:
        text = str(command.get("text") or "mark")[:200]
        self._marks.publish(String(data=text))
        self._node.event("request", text)
        reply(True, "")

    def _needs(self, publisher: Any, receiver: str) -> None:
        if not publisher.get_subscription_count():
            raise CommandError(f"no {receiver} is running that could receive this")

    def _call(self, kind: Any, node: str, service: str, value: bool | None, reply: Reply) -> None:
        request = kind.Request() if value is None else kind.Request(data=value)

        def answered(response: Any) -> None:
            reply(bool(response.success), str(response.message))

        self._ask(kind, f"{node}/{service}", request, answered)

    def _ask(self, kind: Any, service: str, request: Any, answered: Callable[[Any], None]) -> None:
        client = self._clients[service]
        if not client.service_is_ready():
            raise CommandError(f"{service} does not answer; does the node run?")
        future = client.call_async(request)
        future.add_done_callback(lambda done: answered(done.result()))

    def _do_set(self, command: Mapping[str, Any], reply: Reply) -> None:
        node, name = str(command.get("node")), str(command.get("name"))
        field = self._fields.get(node, {}).get(name)
        if field is None:
            raise CommandError(f"'{name[:60]}' of {node[:40]} cannot be changed while it runs")
        try:
            value = _CASTS[ros_type(field).name](command["value"])
        except (KeyError, TypeError, ValueError, OverflowError):
            raise CommandError(f"{name}: expected a {ros_type(field).name.lower()}") from None
        parameter = to_parameter(name, field, value).to_parameter_msg()

        def answered(response: Any) -> None:
            (result,) = response.results
            reply(bool(result.successful), str(result.reason) or f"{name} = {value}")

        request = SetParameters.Request(parameters=[parameter])
        self._ask(SetParameters, f"{node}/set_parameters", request, answered)

    def _do_parameters(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Reply with the declarations and values of the live parameters of a node, as JSON."""
        node = str(command.get("node"))
        fields = self._fields.get(node)
        if not fields:
            raise CommandError(f"{node[:40]} has no live parameters")

        def answered(response: Any) -> None:
            values = map(parameter_value_to_python, response.values)
            pairs = zip(fields.items(), values, strict=True)
            reply(True, json.dumps([_declared(n, f, value) for (n, f), value in pairs]))

        request = GetParameters.Request(names=list(fields))
        self._ask(GetParameters, f"{node}/get_parameters", request, answered)

    def _do_fault(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Stop, continue or stall the process of a node."""
        node, what = str(command.get("node")), str(command.get("what"))
        pid = self._node.process_of(node)
        if pid is None or not _is_ours(pid, node):
            raise CommandError(
                f"{node[:40]} has no process of its own here; start the run with --processes"
            )
        if what == "stall":
            _send(pid, signal.SIGSTOP)
            threading.Timer(_STALL, _send, (pid, signal.SIGCONT)).start()
        elif what in _SIGNALS:
            _send(pid, _SIGNALS[what])
            (self._stopped.add if what == "stop" else self._stopped.discard)(pid)
        else:
            raise CommandError(f"'{what[:40]}' is not a fault")
        self._node.event("disturbance", f"a user: {what} {node}".replace("_", " "))
        reply(True, f"{node}: {what}")

    def close(self) -> None:
        """Let stopped processes continue, so that they can end."""
        for pid in self._stopped:
            _send(pid, signal.SIGCONT)

    def _do_save(self, command: Mapping[str, Any], reply: Reply) -> None:
        bag = self._node.config.bag
        if not bag:
            raise CommandError("nothing is recorded that could be saved")
        (last,) = _numbers(command, "last", 1)
        given = Path(bag), self._node.since(float(last)), reply
        threading.Thread(target=self._save, args=given, daemon=True).start()

    def _save(self, bag: Path, last: float, reply: Reply) -> None:
        """Copy what was received in the last seconds, 0 for all, to a bag; write its report."""
        count = 1
        while (folder := bag.parent / f"saved-{count}").exists():
            count += 1
        folder.mkdir()
        copying = ["recover", bag, "--out", folder / "bag", "--last", last]
        for words in (copying, ["report", folder]):
            line = ["nice", sys.executable, "-m", f"{PACKAGE}.cli", *map(str, words)]
            done = subprocess.run(line, capture_output=True, text=True)
            if done.returncode:
                reply(False, f"not saved: {done.stderr.strip()[-300:]}")
                return
        self._node.report = folder / "report.html"
        reply(True, f"saved in {folder}")


def _declared(name: str, field: Any, value: Any) -> dict[str, Any]:
    limits = [bound_of(field, bound) for bound in ("ge", "gt", "le", "lt")]
    low, high = [next((v for v in p if v is not None), None) for p in (limits[:2], limits[2:])]
    return {
        "name": name,
        "value": value,
        "meaning": field.description,
        "unit": unit_of(field),
        "choices": choices_of(field.annotation),
        "min": low,
        "max": high,
    }


def _numbers(command: Mapping[str, Any], key: str, count: int) -> Any:
    """Return `count` finite numbers of a command, shape (count,)."""
    given = command.get(key)
    listed: Sequence[Any] = given if isinstance(given, list) else [given]
    is_number = [type(v) in (int, float) and math.isfinite(v) for v in listed]
    if len(listed) != count or not all(is_number):
        raise CommandError(f"{key} is {str(given)[:60]}, expected {count} finite numbers")
    return np.array(listed, dtype=float)


def _send(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):  # it has ended
        os.kill(pid, number)


def _is_ours(pid: int, node: str) -> bool:
    """Return whether a process on this machine is the executable of a node."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return any(word.endswith(f"/{PACKAGE}/{node}".encode()) for word in words[:3])
