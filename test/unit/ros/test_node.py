# SPDX-License-Identifier: Apache-2.0
"""The base of all nodes: it survives and reports bad messages and errors, and counts peers."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
from support.nodes import Process, counts, facts

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import MessageError, TactileHandError, UnsafeOutputError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR, OK, WARN
from tactile_hand_ros.ros.endpoints import described, location, refusal
from tactile_hand_ros.ros.messages import read_number
from tactile_hand_ros.ros.node import TactileNode

HERE = Path(__file__).name


class FatalError(Exception):
    """Ends the node."""


class Gains(Config):
    """Two live numbers."""

    gain: float = param(1.0, "Gain", ge=0.0, live=True)
    other: float = param(1.0, "Other", live=True)


class Example(TactileNode[Gains]):
    """A node that can fail in every way."""

    fatal = (FatalError,)

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("example", Gains, namespace="/left", **kwargs)
        self.got: list[float] = []
        self.calls: list[Any] = []
        self.error: Exception = KeyError("left")
        self.subscribe(Float64, "x", self._on_x, sensor=True, raw=True)
        self.subscribe(Float64, "y", self.fail)
        fail = self.guarded("ticks", self.fail)
        self.subscribe(Float64, "later", lambda _: self.executor.after_reading(fail))
        self.create_service(Trigger, "~/fail", self.fail)

    def _on_x(self, data: bytes, info: Any) -> None:
        assert info["source_timestamp"] > 0
        self.got.append(self.config.gain * read_number(data))

    def fail(self, *_: Any) -> None:
        raise self.error

    def on_config(self, config: Gains) -> None:
        if config.gain == 13.0:
            raise TactileHandError("13 brings bad luck.")
        if config.gain == 14.0:
            raise KeyError("left")

    def check_config(self, config: Gains) -> None:
        if config.gain == 15.0:
            raise TactileHandError("15 is too much.")
        if config.gain == 16.0:
            raise KeyError("left")

    def on_report(self) -> None:
        self.diagnostics.value("messages", len(self.got))

    def to_safe_state(self, reason: str) -> None:
        self.calls.append(("safe", reason))
        raise RuntimeError("not safe either")

    def on_rejected(self, source: str, reason: str) -> None:
        self.calls.append((source, reason))


@pytest.fixture
def node(here: Process) -> Example:
    made = Example(context=here.context)
    here.add(made)
    return made


def logged(here: Process) -> Callable[[], list[str]]:
    """Return a function for the lines that the node has logged."""
    here.receive(Log, "/rosout")
    return lambda: [m.msg for m in here.messages("/rosout", 0) if "example" in m.name]


def test_a_bad_message_is_counted_logged_once_and_survived(here, node):
    lines = logged(here)
    for value in (math.nan, math.nan, 2.0):
        here.send("/left/x", Float64(data=value))
    here.wait(lambda: node.got == [2.0], "the good message after the bad ones")
    reason = "data is nan, expected a finite number up to 1e+09."
    status = node.diagnostics.status()
    assert (status.level, status.name) == (WARN, "/left/example")
    assert status.message == f"2 messages on x rejected: {reason}"
    assert facts(node)["rejected x"] == "2" and facts(node)["messages"] == "1"
    assert node.calls == [("x", reason)] * 2
    here.wait(lambda: lines() == [f"rejected a message on 'x': {reason}"], "a line")


def test_no_callback_ends_a_node(here, node):
    """An unexpected error is logged once per source, and makes the node safe each time."""
    lines = logged(here)
    node.create_timer(0.01, node.fail)
    for topic in ("y", "later"):
        here.send(f"/left/{topic}", Float64(data=1.0))
    answer = here.call(Trigger, "/left/example/fail")
    timer = "timer Example.fail"
    sources = {"y", "ticks", "~/fail", timer, "safe state"}
    here.wait(lambda: set(counts(node, "errors")) == sources, "all sources")
    here.wait(lambda: counts(node, "errors")[timer] > 3, "the timer to go on")
    assert not answer.success
    assert answer.message.startswith(f"KeyError at {HERE}:") and "'left'" in answer.message
    here.wait(lambda: len(lines()) == len(sources), "a line for each")
    assert sum(line.startswith(f"error in 'y': KeyError at {HERE}:") for line in lines()) == 1
    errors = counts(node, "errors")
    assert errors["safe state"] == len(node.calls) == sum(errors.values()) - len(node.calls)
    status = node.diagnostics.status()
    assert status.level == ERROR and " errors in " in status.message
    assert facts(node)["errors y"] == "1" and "KeyError" in facts(node)["last error y"]


def test_an_output_that_is_not_safe_is_no_bad_message_and_a_fatal_error_ends_the_node(node):
    node.error = UnsafeOutputError("nan")
    assert node.guarded("ticks", node.fail)() is None
    assert counts(node, "errors")["ticks"] == 1 and counts(node, "rejected") == {}
    node.error = FatalError("end")
    with pytest.raises(FatalError, match="end"):
        node.guarded("ticks", node.fail)()
    node.error = MessageError("end")
    node.context.try_shutdown()
    with pytest.raises(MessageError, match="end"):
        node.guarded("ticks", node.fail)()
    assert counts(node, "errors")["ticks"] == 1


def test_an_error_at_a_tick_is_counted_once(node):
    def answer() -> None:
        with node.answering():
            node.fail()

    assert node.guarded("x", answer)() is None
    assert counts(node, "errors")["ticks"] == 1 and counts(node, "rejected") == {}


def test_a_service_refuses_in_the_fields_of_its_type():
    for kind in (Trigger, SetBool):
        answer = refusal(kind.Request(), kind.Response(success=True, message="yes"), "no")
        assert (answer.success, answer.message) == (False, "no")
    request = SetParameters.Request(parameters=[ParameterMessage(name="a")] * 2)
    results = refusal(request, SetParameters.Response(), "no").results
    assert [(each.successful, each.reason) for each in results] == [(False, "no"), (False, "no")]
    answer = refusal(request, SetParametersAtomically.Response(), "no")
    assert (answer.result.successful, answer.result.reason) == (False, "no")
    other = object()
    assert refusal(request, other, "no") is other


def test_the_place_is_the_innermost_of_this_package_or_else_of_all():
    try:
        read_number(b"")
    except MessageError as error:
        assert location(error).startswith("ros/messages.py:")
        assert described(error).startswith("MessageError at ros/messages.py:")
    try:
        np.array([1.0]).reshape(7)
    except ValueError as error:
        assert location(error).startswith(f"{HERE}:")
    assert location(ValueError("never raised")) == "unknown"


def test_health_is_reported_when_a_peer_comes_or_goes(here, node):
    here.receive(DiagnosticArray, names.DIAGNOSTICS)
    node.create_publisher(Float64, "z", 1)

    def is_reported(count: str) -> bool:
        found = [s for m in here.messages(names.DIAGNOSTICS, 0) for s in m.status]
        values = {pair.key: pair.value for pair in found[-1].values} if found else {}
        assert {status.name for status in found} <= {"/left/example"}
        return values.get("publications /left/z") == count

    reader = here.user.create_subscription(Float64, "/left/z", print, 1)
    here.wait(lambda: is_reported("1"), "the reader")
    here.user.destroy_subscription(reader)
    here.wait(lambda: is_reported("0"), "its end")


def test_a_configuration_that_cannot_be_taken_over_is_a_fault_until_the_next(node):
    def change(value: float) -> tuple[bool, str]:
        (result,) = node.set_parameters([Parameter("gain", value=value)])
        return result.successful, result.reason

    assert change(13.0)[0] and node.config.gain == 13.0
    status = node.diagnostics.status()
    assert (status.level, status.message) == (ERROR, "13 brings bad luck.")
    assert change(2.0)[0] and node.diagnostics.status().level == OK
    assert change(14.0)[0] and counts(node, "errors")["configuration"] == 1
    assert node.calls[-1][0] == "safe"
    assert change(15.0) == (False, "15 is too much.")
    successful, reason = change(16.0)
    assert not successful and reason.startswith("KeyError at ros/parameters.py:")
    assert node.config.gain == 14.0
    assert not change(-1.0)[0]


def test_a_subscription_has_the_quality_of_service_of_ticks_or_its_own(node):
    made = node.subscribe(Float64, "a", print, profile=QoSProfile(depth=7), raw=True)
    assert made.qos_profile.depth == 7 and made.raw
    plain, sensor = (node.subscribe(Float64, n, print, sensor=n == "s") for n in ("p", "s"))
    assert plain.qos_profile.depth == qos.TICK_DEPTH and not plain.raw
    known = set(node.get_parameters_by_prefix("qos_overrides"))
    assert any("/left/s." in name for name in known)
    assert not any("/left/p." in name for name in known)
    assert sensor.qos_profile.depth == plain.qos_profile.depth


def test_a_sensor_subscription_may_be_made_best_effort(here):
    override = "qos_overrides./left/x.subscription.reliability:=best_effort"
    node = Example(context=here.context, cli_args=["--ros-args", "-p", override])
    here.add(node)
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    here.send("/left/x", Float64(data=1.0), best_effort)
    here.wait(lambda: node.got == [1.0], "the message")
    other = node.subscribe(Float64, "other", print)
    assert other.qos_profile.reliability == ReliabilityPolicy.RELIABLE


@pytest.mark.parametrize(
    ("make", "depth", "durability"),
    [
        (lambda: qos.TICK_DEPTH, 100, DurabilityPolicy.VOLATILE),
        (lambda: qos.PUBLISHED_DEPTH, 3000, DurabilityPolicy.VOLATILE),
        (qos.latched_qos, 1, DurabilityPolicy.TRANSIENT_LOCAL),
        (lambda: qos.USER_DEPTH, 100, DurabilityPolicy.VOLATILE),
    ],
)
def test_profiles_are_as_the_documentation_says_and_new_each_time(node, make, depth, durability):
    profile = node.subscribe(Float64, "a", print, profile=make()).qos_profile
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.history == HistoryPolicy.KEEP_LAST
    assert (profile.depth, profile.durability) == (depth, durability)
    profile.depth = 7  # rclpy writes into it, too
    assert node.subscribe(Float64, "b", print, profile=make()).qos_profile.depth == depth
