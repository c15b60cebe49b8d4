# SPDX-License-Identifier: Apache-2.0
"""Parameters of a real node: types, ranges, files, changes while it runs."""

import enum
import math
from typing import Literal

import pytest
import rclpy
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from support.spinning import spinning

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.parameters import ConfigParameters, to_params_yaml
from tactile_hand_ros.ros.processes import wait_until


class Law(str, enum.Enum):
    PROPOSED = "proposed"
    KAWAMURA = "kawamura"


class Body(Config):
    mass: float = param(0.1, "Mass", unit="kg", gt=0.0)


class Push(Config):
    kind: Literal["step", "ramp"] = param("step", "Shape over time")
    start: float = param(0.0, "Start", unit="s", ge=0.0)


class Example(Config):
    body: Body = Body()
    law: Law = param(Law.PROPOSED, "Control law", live=True)
    k_p: float = param(3.0, "Stiffness", unit="N/m", ge=0.0, le=10.0, live=True)
    k_max: float = param(5.0, "Largest stiffness", unit="N/m", live=True)
    steps: int = param(2, "Steps a tick", gt=0, live=True)
    noisy: bool = param(False, "Whether there is noise", live=True)
    name: str = param("y", "Name")
    weights: tuple[float, ...] = param((10.0, 1.0, 10.0), "Weights", live=True)
    topics: tuple[str, ...] = param((), "Topics", live=True)
    counts: tuple[int, ...] = param((), "Counts")
    pushes: tuple[Push, ...] = param((), "Disturbances", live=True)

    def model_post_init(self, _context):
        if self.k_p > self.k_max:
            raise ValueError("k_p is above k_max, raise k_max first")


@pytest.fixture(scope="module")
def domain():
    with isolated_domain() as number:
        yield number


@pytest.fixture
def declare(domain):
    """Declare the example on a node that got some ROS arguments."""
    opened = []

    def start(*arguments, on_change=None, namespace="left"):
        context = private_context(domain, ["--ros-args", *arguments])
        node = rclpy.create_node("plant", namespace=namespace, context=context.__enter__())
        opened.append((context, node))
        return node, ConfigParameters(node, Example, on_change)

    yield start
    for context, node in opened:
        node.destroy_node()
        context.__exit__(None, None, None)


def set_one(node, name, value):
    return node.set_parameters([Parameter(name, value=value)])[0]


def test_defaults_are_declared_with_their_types(declare):
    node, parameters = declare()
    assert parameters.config == Example()
    for name, kind, value in [
        ("body.mass", Parameter.Type.DOUBLE, 0.1),
        ("law", Parameter.Type.STRING, "proposed"),
        ("steps", Parameter.Type.INTEGER, 2),
        ("noisy", Parameter.Type.BOOL, False),
        ("weights", Parameter.Type.DOUBLE_ARRAY, [10.0, 1.0, 10.0]),
        ("topics", Parameter.Type.STRING_ARRAY, []),
        ("counts", Parameter.Type.INTEGER_ARRAY, []),
        ("pushes", Parameter.Type.STRING_ARRAY, []),
    ]:
        parameter = node.get_parameter(name)
        assert parameter.type_ is kind, name
        assert list(parameter.value) == value if kind.name.endswith("ARRAY") else True
        assert kind.name.endswith("ARRAY") or parameter.value == value


def test_descriptors_tell_unit_range_choices_and_read_only(declare):
    node, _ = declare()
    gain = node.describe_parameter("k_p")
    assert gain.description == "Stiffness [N/m]"
    assert gain.type == ParameterType.PARAMETER_DOUBLE
    limits = gain.floating_point_range[0]
    assert (limits.from_value, limits.to_value, gain.read_only) == (0.0, 10.0, False)
    mass = node.describe_parameter("body.mass")
    assert mass.read_only
    assert (mass.floating_point_range[0].from_value, mass.floating_point_range[0].to_value) == (
        0.0,
        math.inf,
    )
    steps = node.describe_parameter("steps").integer_range[0]
    assert (steps.from_value, steps.to_value) == (1, 2**63 - 1)
    assert "one of proposed, kawamura" in node.describe_parameter("law").additional_constraints


@pytest.mark.parametrize(
    ("argument", "field", "value"),
    [
        ("k_p:=4", "k_p", 4.0),
        ("k_p:=4.5", "k_p", 4.5),
        ("law:=kawamura", "law", Law.KAWAMURA),
        ("weights:=[1, 2]", "weights", (1.0, 2.0)),
        ("weights:=[]", "weights", ()),
        ("topics:=['a', 'b']", "topics", ("a", "b")),
        ("pushes:=['{kind: ramp, start: 2}']", "pushes", (Push(kind="ramp", start=2.0),)),
        ("steps:=3.0", "steps", 3),
    ],
)
def test_values_from_the_command_line(declare, argument, field, value):
    node, parameters = declare("-p", argument)
    assert getattr(parameters.config, field) == value
    assert node.has_parameter(field)


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("k_p:=40.0", "/left/plant: k_p is 40.0, expected a finite number >= 0.0 and <= 10.0 N/m"),
        ("k_p:=.nan", "k_p is nan"),
        ("k_p:=true", "k_p is True, expected a finite number"),
        ("k_p:='4'", "k_p is '4', expected a finite number"),
        ("weights:=[.inf]", r"weights\[0\] is inf"),
        ("law:=best", "law is 'best', expected one of proposed, kawamura"),
        ("body.mass:=0", "body.mass is 0"),
        ("k_p:=6.0", "k_p is above k_max, raise k_max first"),
        ("pushes:=['{kind: shove}']", r"pushes\[0\].kind is 'shove', expected one of step, ramp"),
        ("pushes:=['{kind: [']", "not valid YAML"),
        ("kp:=4.0", "unknown parameter 'kp', did you mean 'k_p'"),
        ("body.mas:=4.0", "unknown parameter 'body.mas', did you mean 'body.mass'"),
    ],
)
def test_bad_values_end_the_start_with_a_reason(declare, argument, words):
    with pytest.raises(ConfigurationError, match=words):
        declare("-p", argument)


def test_parameters_for_another_node_are_not_mistaken(declare):
    arguments = ("-p", "other:nonsense:=1", "-p", "plant:k_p:=1.0")
    _, parameters = declare(*arguments, namespace="")
    assert parameters.config.k_p == 1.0


@pytest.mark.parametrize("namespace", ["", "left", "left/arm"])
@pytest.mark.parametrize("node_name", ["plant", ""])
def test_a_written_file_gives_the_same_configuration(declare, tmp_path, namespace, node_name):
    config = Example(
        body=Body(mass=1e-5),
        law=Law.KAWAMURA,
        k_p=1.0,
        noisy=True,
        name="on",
        weights=(),
        topics=("no", "1.5", "it's"),
        counts=(1, 2),
        pushes=(Push(kind="ramp", start=1e-3), Push()),
    )
    path = tmp_path / "plant.yaml"
    path.write_text(to_params_yaml(config, node_name))
    _, parameters = declare("--params-file", str(path), namespace=namespace)
    assert parameters.config == config


def test_a_file_for_another_node_is_not_taken(declare, tmp_path):
    path = tmp_path / "other.yaml"
    path.write_text(to_params_yaml(Example(k_p=1.0), "other"))
    assert declare("--params-file", str(path))[1].config == Example()


def test_simulated_time_and_quality_of_service_are_no_unknown_parameters(declare):
    node, parameters = declare(
        "-p", "use_sim_time:=true", "-p", "qos_overrides./x.subscription.reliability:=best_effort"
    )
    assert node.get_parameter("use_sim_time").value is True
    with pytest.raises(ConfigurationError, match="unknown parameter 'qos_overrides./x"):
        parameters.check_qos_overrides()


def test_a_live_change_is_taken_and_announced(declare):
    seen = []
    node, parameters = declare(on_change=seen.append)
    assert set_one(node, "k_p", 4.0).successful
    assert parameters.config.k_p == 4.0
    assert seen == [parameters.config]
    assert set_one(node, "k_p", 2).successful
    assert node.get_parameter("k_p").type_ is Parameter.Type.DOUBLE
    assert set_one(node, "pushes", ["{kind: ramp}"]).successful
    assert parameters.config.pushes == (Push(kind="ramp"),)
    assert set_one(node, "pushes", []).successful
    assert parameters.config.pushes == ()
    assert node.get_parameter("pushes").type_ is Parameter.Type.STRING_ARRAY
    assert set_one(node, "weights", [1, 2]).successful
    assert parameters.config.weights == (1.0, 2.0)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("k_p", 11.0, "out of range"),
        ("k_p", -1.0, "out of range"),
        ("k_p", math.nan, ""),
        ("k_max", math.inf, "finite"),
        ("k_p", "4", "Wrong parameter type"),
        ("k_p", 6.0, "k_p is above k_max, raise k_max first"),
        ("k_max", 1.0, "k_p is above k_max"),
        ("law", "best", "one of proposed, kawamura"),
        ("body.mass", 1.0, "read-only"),
        ("pushes", ["{kind: shove}"], "one of step, ramp"),
        ("pushes", ["{"], "not valid YAML"),
        ("weights", [1.0, math.nan], "finite"),
    ],
)
def test_a_refused_change_changes_nothing(declare, name, value, words):
    seen = []
    node, parameters = declare(on_change=seen.append)
    before = node.get_parameter(name).value
    result = set_one(node, name, value)
    assert not result.successful
    assert words in result.reason
    assert node.get_parameter(name).value == before
    assert parameters.config == Example() and not seen


def test_several_changes_are_taken_or_refused_together(declare):
    seen = []
    node, parameters = declare(on_change=seen.append)
    both = [Parameter("k_p", value=8.0), Parameter("k_max", value=9.0)]
    assert node.set_parameters_atomically(both).successful
    assert len(seen) == 1 and (seen[0].k_p, seen[0].k_max) == (8.0, 9.0)
    bad = [Parameter("steps", value=5), Parameter("k_max", value=1.0)]
    assert not node.set_parameters_atomically(bad).successful
    assert node.get_parameter("steps").value == 2
    assert parameters.config.steps == 2


def test_changes_over_the_parameter_service(declare):
    node, parameters = declare()
    other = rclpy.create_node("user", context=node.context)
    client = AsyncParameterClient(other, "/left/plant")
    with spinning(node, other):
        assert client.wait_for_services(10.0)
        future = client.set_parameters([Parameter("k_p", value=1), Parameter("k_p", value=99.0)])
        wait_until(future.done, message="the answer of the service")
        accepted, refused = future.result().results
        assert accepted.successful and not refused.successful
        assert parameters.config.k_p == 1.0
    other.destroy_node()


def test_a_type_without_ros_counterpart_is_refused_early(declare):
    class Odd(Config):
        table: dict[str, float] = param({}, "No ROS type for this")

    node, _ = declare()
    other = rclpy.create_node("odd", context=node.context)
    with pytest.raises(TypeError, match="not a type that a ROS parameter can have"):
        ConfigParameters(other, Odd)
    other.destroy_node()
