# SPDX-License-Identifier: Apache-2.0
"""Commands of a page to the hand, by the topics, services and parameters that every user has."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pydantic import TypeAdapter, ValidationError
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.cockpit.server import Reply
from tactile_hand_ros.config.explanation import choices_of, is_live, unit_of
from tactile_hand_ros.config.model import leaves
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec, PushCodec
from tactile_hand_ros.ros.parameters import to_parameter
from tactile_hand_ros.ros.processes import PACKAGE
from tactile_hand_ros.scenario.scenario import NODES, Scenario

MOST_FORCE = 30.0
"""Largest force of a push [N]: what a hand on the object could do with ease."""

_CALLS: dict[str, tuple[Any, str, dict[str, bool]]] = {
    "run": (SetBool, f"{names.PLANT}/run", {"data": True}),
    "pause": (SetBool, f"{names.PLANT}/run", {"data": False}),
    "step": (Trigger, f"{names.PLANT}/step", {}),
    "reset": (Trigger, f"{names.PLANT}/reset", {}),
    "grasp": (SetBool, f"{names.CONTROLLER}/grasp", {"data": True}),
    "release": (SetBool, f"{names.CONTROLLER}/grasp", {"data": False}),
    "enable": (SetBool, f"{names.CONTROLLER}/enable", {"data": True}),
    "disable": (SetBool, f"{names.CONTROLLER}/enable", {"data": False}),
}
_SIGNALS = {"stop": signal.SIGSTOP, "stall": signal.SIGSTOP, "continue": signal.SIGCONT}
_STALL = 0.1  # s for which `stall` stops a node


class CommandError(TactileHandError):
    """A command that cannot be carried out."""


def live_parameters(node: str) -> dict[str, Any]:
    """Return the fields of a node that may change during a run."""
    model: Any = Scenario.model_fields[node].annotation
    return {name: field for name, field in leaves(model).items() if is_live(field)}


class Commands:
    """Carries out the commands of the tab in control; called from the executor of the node."""

    def __init__(self, node: Any) -> None:
        """Create publishers and clients of a `CockpitNode`."""
        self._node = node
        make, depth = node.create_publisher, qos.USER_DEPTH
        self._pose = make(PoseStamped, names.DESIRED_POSE, depth)
        self._force = make(Float64, names.USER_GRASP_FORCE, depth)
        self._push = make(WrenchStamped, names.PUSH, depth)
        self._marks = make(String, "marks", depth)
        self._encode_pose = PoseCodec(nan_allowed=True).encode
        self._encode_push = PushCodec().encode
        self._stopped: set[int] = set()
        services: dict[str, Any] = {service: kind for kind, service, _ in _CALLS.values()}
        for owner in NODES:
            services[f"{owner}/set_parameters"] = SetParameters
            services[f"{owner}/get_parameters"] = GetParameters
        # Created before they are needed, so that they are matched by then.
        self._clients = {name: node.create_client(kind, name) for name, kind in services.items()}

    def carry_out(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Carry out a command and reply, immediately or when the hand has answered.

        Raises:
            CommandError: If it cannot be carried out.
            Exception: If the page never sends such a command.
        """
        if command["do"] in _CALLS:
            kind, service, values = _CALLS[command["do"]]
            request = kind.Request(**values)
            self._ask(service, request, lambda r: reply(r.success, r.message))
        else:
            getattr(self, f"_do_{command['do']}")(command, reply)

    def _ask(self, service: str, request: Any, answered: Callable[[Any], None]) -> None:
        client = self._clients[service]
        if not client.service_is_ready():
            raise CommandError(f"{service} does not answer; does the node run?")
        client.call_async(request).add_done_callback(lambda done: answered(done.result()))

    def _do_pose(self, command: Mapping[str, Any], reply: Reply) -> None:
        position, quaternion = (
            np.array(command[key], dtype=float) for key in ("position", "quaternion")
        )
        self._publish(self._pose, self._encode_pose(position, quaternion, 0), reply)

    def _do_force(self, command: Mapping[str, Any], reply: Reply) -> None:
        self._publish(self._force, Float64(data=float(command["value"])), reply)

    def _do_push(self, command: Mapping[str, Any], reply: Reply) -> None:
        wrench = np.array(command["wrench"], dtype=float)
        if np.linalg.norm(wrench[:3]) > MOST_FORCE * 1.001:
            raise CommandError(f"a push of at most {MOST_FORCE:g} N is possible")
        self._publish(self._push, self._encode_push(wrench, self._node.picture.stamp), reply)

    def _publish(self, publisher: Any, message: Any, reply: Reply) -> None:
        if not publisher.get_subscription_count():
            raise CommandError("no node is running that could receive this")
        publisher.publish(message)
        reply(True, "")

    def _do_mark(self, command: Mapping[str, Any], reply: Reply) -> None:
        text = str(command["text"])[:200]
        self._marks.publish(String(data=text))
        self._node.event("request", text)
        reply(True, "")

    def _do_set(self, command: Mapping[str, Any], reply: Reply) -> None:
        node, name = command["node"], command["name"]
        field = live_parameters(node)[name]
        try:
            value = TypeAdapter(field.annotation).validate_python(command["value"])
        except ValidationError as error:
            raise CommandError(f"{name}: {error.errors()[0]['msg']}") from None
        parameter = to_parameter(name, field, value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        self._ask(
            f"{node}/set_parameters",
            request,
            lambda r: reply(r.results[0].successful, r.results[0].reason),
        )

    def _do_parameters(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Reply with the declarations and values of the live parameters of a node, as JSON."""
        node = command["node"]
        fields = live_parameters(node)

        def answered(response: Any) -> None:
            declared = [
                {
                    "name": name,
                    "value": parameter_value_to_python(value),
                    "meaning": field.description,
                    "unit": unit_of(field),
                    "choices": choices_of(field.annotation),
                }
                for (name, field), value in zip(fields.items(), response.values, strict=True)
            ]
            reply(True, json.dumps(declared))

        self._ask(f"{node}/get_parameters", GetParameters.Request(names=list(fields)), answered)

    def _do_fault(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Stop, continue or stall the process of a node."""
        node, what = command["node"], command["what"]
        pid = self._node.process_of(node)
        if pid is None or not _is_ours(pid, node):
            raise CommandError(
                f"{node} has no process of its own here; start the run with --processes"
            )
        _send(pid, _SIGNALS[what])
        self._stopped.add(pid)
        if what == "stall":
            threading.Timer(_STALL, _send, (pid, signal.SIGCONT)).start()
        self._node.event("disturbance", f"a user: {what} {node}".replace("_", " "))
        reply(True, "")

    def close(self) -> None:
        """Let stopped processes continue, so that they can end."""
        for pid in self._stopped:
            _send(pid, signal.SIGCONT)

    def _do_save(self, command: Mapping[str, Any], reply: Reply) -> None:
        if not self._node.config.bag:
            raise CommandError("nothing is recorded that could be saved")
        given = Path(self._node.config.bag), float(command["last"]), reply
        threading.Thread(target=self._save, args=given, daemon=True).start()

    def _save(self, bag: Path, last: float, reply: Reply) -> None:
        """Copy what was received in the last seconds, 0 for all, to a bag; write its report."""
        count = 1
        while (folder := bag.parent / f"saved-{count}").exists():
            count += 1
        copying = ["recover", bag, "--out", folder / "bag", "--last", last]
        try:
            folder.mkdir()
            (folder / "summary.json").write_text('{"interactive": true}', encoding="utf-8")
            for words in (copying, ["report", folder]):
                line = ["nice", sys.executable, "-m", f"{PACKAGE}.cli", *map(str, words)]
                subprocess.run(line, capture_output=True, text=True, check=True)
        except subprocess.CalledProcessError as error:
            reply(False, f"not saved: {error.stderr.strip()[-300:]}")
        except OSError as error:
            reply(False, f"not saved: {error}")
        else:
            self._node.report = folder / "report.html"
            reply(True, f"saved in {folder}")


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
