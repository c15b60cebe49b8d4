# SPDX-License-Identifier: Apache-2.0
"""What a callback throws is counted, logged in a line, and makes the node safe if need be."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros.errors import MessageError, UnsafeOutputError
from tactile_hand_ros.ros.diagnostics import Diagnostics
from tactile_hand_ros.ros.endpoints import CallbackGuard, described, location, refusal
from tactile_hand_ros.ros.messages import checked_number

HERE = Path(__file__).name


class FatalError(Exception):
    """Ends the node."""


class Node:
    """A node as the guard sees it, which notes what is asked of it."""

    fatal = (FatalError,)

    def __init__(self, *, is_up: bool = True, fails: bool = False) -> None:
        self.diagnostics = Diagnostics("node", lambda: 7.0)
        self.context = self
        self.said: list[tuple[str, str]] = []
        self._is_up, self._fails = is_up, fails

    def ok(self) -> bool:
        return self._is_up

    def get_logger(self) -> Node:
        return self

    def warning(self, text: str) -> None:
        self.said.append(("warning", text))

    def error(self, text: str) -> None:
        self.said.append(("error", text))

    def on_rejected(self, source: str, reason: str) -> None:
        self.said.append((f"rejected {source}", reason))

    def to_safe_state(self, reason: str) -> None:
        self.said.append(("safe", reason))
        if self._fails:
            raise KeyError("unsafe")


def throwing(error: Exception) -> Callable[..., None]:
    """Return a callback that fails."""

    def callback(*_: Any) -> None:
        raise error

    return callback


def test_what_goes_well_is_passed_on() -> None:
    node = Node()
    assert CallbackGuard(node).wrap("topic", lambda a, b: a - b)(7, 3) == 4
    assert CallbackGuard(node).wrap_service("service", lambda a, b: a - b)(7, 3) == 4
    assert node.said == [] and node.diagnostics.errors == {}

    wrapped = CallbackGuard(node).wrap("topic", lambda message: None)
    assert list(inspect.signature(wrapped).parameters) == ["message"]


def test_a_rejected_message_is_logged_once_and_the_node_continues() -> None:
    node = Node()
    callback = CallbackGuard(node).wrap("pose", throwing(MessageError("not\n  a pose")))
    assert callback(1) is None and callback(2) is None
    assert node.said == [
        ("warning", "rejected a message on 'pose': not a pose"),
        ("rejected pose", "not a pose"),
        ("rejected pose", "not a pose"),
    ]
    assert node.diagnostics.rejected == {"pose": 2} and node.diagnostics.errors == {}


@pytest.mark.parametrize("error", [ValueError("x"), UnsafeOutputError("x")])
def test_what_was_not_foreseen_is_logged_once_and_makes_the_node_safe(error: Exception) -> None:
    node = Node()
    callback = CallbackGuard(node).wrap("timer", throwing(error))
    callback()
    callback()
    assert [kind for kind, _ in node.said] == ["error", "safe", "safe"]
    assert node.said[0][1].startswith(f"error in 'timer': {type(error).__name__} at {HERE}:")
    assert node.diagnostics.errors == {"timer": 2} and node.diagnostics.rejected == {}


@pytest.mark.parametrize("kind", ["fatal", "down"])
def test_what_ends_the_node_is_not_caught(kind: str) -> None:
    node = Node(is_up=kind != "down")
    error = FatalError("end") if kind == "fatal" else ValueError("end")
    with pytest.raises(type(error), match="end"):
        CallbackGuard(node).wrap("timer", throwing(error))()
    assert node.said == [] and node.diagnostics.errors == {}


def test_a_service_rejects_in_the_fields_of_its_type() -> None:
    guard = CallbackGuard(Node())
    for kind in (Trigger, SetBool):
        answer = guard.wrap_service("~/reset", throwing(MessageError("no")))(
            kind.Request(), kind.Response(success=True, message="yes")
        )
        assert not answer.success and answer.message.endswith(": no")
        assert answer.message.startswith(f"MessageError at {HERE}:")
    request = SetParameters.Request(parameters=[Parameter(name="a"), Parameter(name="b")])
    results = refusal(request, SetParameters.Response(), "no").results
    assert [(each.successful, each.reason) for each in results] == [(False, "no"), (False, "no")]
    answer = refusal(request, SetParametersAtomically.Response(), "no")
    assert (answer.result.successful, answer.result.reason) == (False, "no")
    other = object()
    assert refusal(request, other, "no") is other


def test_the_place_is_the_innermost_of_this_package_or_else_of_all() -> None:
    try:
        checked_number(math.nan)
    except MessageError as error:
        assert location(error).startswith("ros/messages.py:")
        assert described(error).startswith("MessageError at ros/messages.py:")
    try:
        np.array([1.0]).reshape(7)
    except ValueError as error:
        assert location(error).startswith(f"{HERE}:")
    assert location(ValueError("never raised")) == "unknown"
    node = Node()
    CallbackGuard(node).wrap("a", throwing(ValueError("x")))()
    assert f" at {HERE}:" in node.said[0][1]  # not the guard's own line
