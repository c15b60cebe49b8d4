# SPDX-License-Identifier: Apache-2.0
"""A node survives bad messages, says so on /diagnostics, and its process ends as it should."""

import psutil
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from support.spinning import spinning

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import checked_number
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.processes import start_executable, wait_until


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


def test_local_nodes_listen_on_the_loopback_address_only(node):
    connections = psutil.Process().net_connections(kind="udp")
    listening = {each.laddr.ip for each in connections if each.laddr.port > 0}
    assert listening == {"127.0.0.1"}


@pytest.fixture
def user(context):
    made = rclpy.create_node("user", context=context)
    yield made
    made.destroy_node()


def test_a_bad_message_is_counted_reported_and_survived(node, user):
    reports = []
    user.create_subscription(
        DiagnosticArray, names.DIAGNOSTICS, lambda m: reports.append(m.status[0]), 10
    )
    publisher = user.create_publisher(Float64, "/left/x", 10)
    with spinning(node, user):
        wait_until(lambda: publisher.get_subscription_count() == 1)
        wait_until(lambda: user.count_publishers(names.DIAGNOSTICS) == 1)
        publisher.publish(Float64(data=float("nan")))
        publisher.publish(Float64(data=2.0))
        wait_until(lambda: node.got == [2.0], message="the good message after the bad one")
        report = wait_until(lambda: [r for r in reports if r.level == DiagnosticStatus.WARN])[-1]
    assert report.name == "/left/example"
    words = "1 message on x rejected: data is nan, expected a finite number up to 1e+09."
    assert report.message == words
    shown = {pair.key: pair.value for pair in report.values}
    assert shown["rejected x"] == "1"
    assert shown["messages"] == "1"


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


def test_a_parameter_of_an_unknown_type_is_refused(node, user):
    with spinning(node, user):
        for number, name in ((10, "gain"), (255, "no_such")):
            odd = ParameterMessage(name=name, value=ParameterValue(type=number))
            good = Parameter("gain", value=2.0).to_parameter_msg()
            both = call(
                user,
                SetParameters,
                "left/example/set_parameters",
                SetParameters.Request(parameters=[odd, good]),
            )
            assert [result.successful for result in both.results] == [False, False]
            assert f"has type {number}" in both.results[0].reason
            together = call(
                user,
                SetParametersAtomically,
                "left/example/set_parameters_atomically",
                SetParametersAtomically.Request(parameters=[good, odd]),
            )
            assert not together.result.successful
    assert node.diagnostics.errors == {}


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


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("minimum_norma:=1.0", "unknown parameter 'minimum_norma', did you mean 'minimum_normal'"),
        ("qos_overrides./q.subscription.depth:=3", "unknown parameter 'qos_overrides./q"),
    ],
)
def test_a_wrong_parameter_ends_the_start_with_a_sentence(domain, parameter, words):
    with start_executable("force_optimizer", "--ros-args", "-p", parameter) as process:
        assert process.wait() == 2
        assert words in process.stderr and "Traceback" not in process.stderr
