# SPDX-License-Identifier: Apache-2.0
"""A node survives bad messages, says so on /diagnostics, and its process ends as it should."""

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from support.spinning import spinning

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import checked_number
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.processes import wait_until


class ExampleConfig(Config):
    gain: float = param(1.0, "Gain", ge=0.0, live=True)


class Example(TactileNode[ExampleConfig]):
    def __init__(self, **kwargs):
        super().__init__("example", ExampleConfig, **kwargs)
        self.got = []
        self.subscribe(Float64, "x", self._on_x, sensor=True)

    def _on_x(self, message):
        self.got.append(self.config.gain * checked_number(message.data))
        self.diagnostics.tick()

    def on_config(self, config):
        if config.gain == 13.0:
            raise TactileHandError("13 brings bad luck.")

    def on_report(self):
        self.diagnostics.value("messages", len(self.got))


@pytest.fixture(scope="module")
def domain():
    with isolated_domain() as number:
        yield number


@pytest.fixture
def context(domain):
    with private_context(domain) as own:
        yield own


@pytest.fixture
def node(context):
    made = Example(context=context, namespace="left")
    yield made
    made.destroy_node()


@pytest.fixture
def user(context):
    made = rclpy.create_node("user", context=context)
    yield made
    made.destroy_node()


class Fragile(Example):
    """Fails at everything, in every way, and goes on."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.safe = []
        self.subscribe(Float64, "y", self._fail)
        fail = self.guarded("ticks", self._fail)
        self.subscribe(Float64, "later", lambda _: self.executor.after_reading(fail))
        self.create_timer(0.01, self._fail)
        self.create_service(Trigger, "~/fail", lambda request, response: self._fail())

    def _fail(self, _=None):
        return {}["left"]

    def to_safe_state(self, reason):
        self.safe.append(reason)
        raise RuntimeError("not safe either")

    def on_config(self, config):
        return 1.0 / (config.gain - 13.0)


@pytest.fixture
def fragile(context):
    made = Fragile(context=context)
    yield made
    made.destroy_node()


def call(user, kind, name, request):
    client = user.create_client(kind, name)
    assert client.wait_for_service(10.0)
    future = client.call_async(request)
    wait_until(future.done, message=f"an answer of {name}")
    return future.result()


def test_no_callback_ends_a_node(fragile, user):
    publishers = [user.create_publisher(Float64, topic, 10) for topic in ("y", "later", "x")]
    with spinning(fragile, user):
        wait_until(lambda: all(p.get_subscription_count() for p in publishers))
        for publisher in publishers:
            publisher.publish(Float64(data=1.0))
        answer = call(user, Trigger, "example/fail", Trigger.Request())
        wait_until(lambda: fragile.got == [1.0], message="the good message after the bad ones")
        timer = "timer Fragile._fail"
        sources = {"y", "ticks", "~/fail", timer, "safe state"}
        wait_until(lambda: set(fragile.diagnostics.errors) == sources, message="all sources")
        wait_until(lambda: fragile.diagnostics.errors[timer] > 3, message="the timer to go on")
        fragile.set_parameters([Parameter("gain", value=13.0)])
        assert fragile.diagnostics.errors["configuration"] == 1
    assert not answer.success
    assert answer.message.startswith("KeyError at test_node.py:") and "'left'" in answer.message
    assert len(set(fragile.safe)) > 1
    status = fragile.diagnostics.status()
    assert status.level == DiagnosticStatus.ERROR and " errors in " in status.message
    shown = {pair.key: pair.value for pair in status.values}
    assert shown["errors y"] == "1" and "KeyError" in shown["last error y"]


def test_a_sensor_subscription_may_be_made_best_effort(domain):
    arguments = "--ros-args -p qos_overrides./x.subscription.reliability:=best_effort".split()
    with private_context(domain, arguments) as context:
        node = Example(context=context)
        node.check_ready()
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        publisher = node.create_publisher(Float64, "x", best_effort)
        with spinning(node):
            wait_until(lambda: publisher.get_subscription_count() == 1)
            publisher.publish(Float64(data=1.0))
            wait_until(lambda: node.got == [1.0])
        assert qos.tick_qos().reliability == ReliabilityPolicy.RELIABLE
        node.destroy_node()
