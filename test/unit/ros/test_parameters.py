# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node from a configuration: types, ranges, files, changes at run time."""

import enum
import math
import sys
from contextlib import ExitStack
from typing import Literal

import pytest
import rclpy
from rclpy.parameter import Parameter

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.parameters import ConfigParameters, to_params_yaml


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


@pytest.fixture
def declare(domain, monkeypatch):
    """Declare the example on a node with some ROS arguments."""
    with ExitStack() as stack:

        def start(*arguments, on_change=lambda _: None, namespace="left"):
            monkeypatch.setattr(sys, "argv", ["plant", "--ros-args", *arguments])
            context = stack.enter_context(ros_context(["--ros-args", *arguments], domain))
            node = rclpy.create_node("plant", namespace=namespace, context=context)
            stack.callback(node.destroy_node)
            return node, ConfigParameters(node, Example, on_change)

        yield start


def set_one(node, name, value):
    return node.set_parameters([Parameter(name, value=value)])[0]


@pytest.mark.parametrize(
    ("arguments", "changes"),
    [
        (("k_p:=4", "weights:=[1, 2]"), {"k_p": 4.0, "weights": (1.0, 2.0)}),
        (("k_p:=4.5", "weights:=[]", "steps:=3.0"), {"k_p": 4.5, "weights": (), "steps": 3}),
        (("law:=kawamura", "topics:=['a', 'b']"), {"law": Law.KAWAMURA, "topics": ("a", "b")}),
        (("pushes:=['{kind: ramp, start: 2}']",), {"pushes": (Push(kind="ramp", start=2.0),)}),
    ],
)
def test_values_from_the_command_line(declare, arguments, changes):
    node, parameters = declare(*[word for argument in arguments for word in ("-p", argument)])
    assert parameters.config == Example(**changes)
    assert all(map(node.has_parameter, changes))


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("k_p:=40.0", "/left/plant: k_p is 40.0, but should be less than or equal to 10 .N/m."),
        ("k_p:=true", "k_p is invalid: true or false is not a number"),
        ("k_p:=6.0", "k_p is above k_max, raise k_max first"),
        ("pushes:=['{kind: [']", "not valid YAML"),
        ("kp:=4.0", "unknown parameter 'kp', did you mean 'k_p'"),
        ("body.mas:=4.0", "unknown parameter 'body.mas', did you mean 'body.mass'"),
    ],
)
def test_bad_values_end_the_start_with_a_reason(declare, argument, words):
    with pytest.raises(ConfigurationError, match=words):
        declare("-p", argument)


def test_an_unknown_parameter_of_this_node_only_ends_the_start_too(declare):
    with pytest.raises(ConfigurationError, match="unknown parameter 'kp', did you mean 'k_p'"):
        declare("-p", "plant:kp:=4.0", namespace="")


@pytest.mark.parametrize("namespace", ["", "left/arm"])
def test_a_written_file_gives_the_same_configuration(declare, tmp_path, namespace):
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
    path.write_text(to_params_yaml(config, "plant"))
    _, parameters = declare("--params-file", str(path), namespace=namespace)
    assert parameters.config == config


def test_simulated_time_and_quality_of_service_are_no_unknown_parameters(declare):
    best_effort = "qos_overrides./x.subscription.reliability:=best_effort"
    node, _ = declare("-p", "use_sim_time:=true", "-p", best_effort)
    assert node.get_parameter("use_sim_time").value is True


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
        ("k_p", 11.0, "less than or equal to 10"),
        ("k_p", -1.0, "greater than or equal to 0"),
        ("k_p", math.nan, ""),
        ("k_max", math.inf, "finite"),
        ("k_p", "4", "Wrong parameter type"),
        ("k_p", 6.0, "k_p is above k_max, raise k_max first"),
        ("k_max", 1.0, "k_p is above k_max"),
        ("law", "best", "'proposed' or 'kawamura'"),
        ("body.mass", 1.0, "read-only"),
        ("pushes", ["{kind: shove}"], "'step' or 'ramp'"),
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


FOREIGN = """
/**:
  ros__parameters: {k_p: 1.5, arm_gain: 3.0}
/**/arm:
  ros__parameters: {k_max: 9.0}
"""


def test_a_file_may_have_parameters_of_other_nodes(declare, tmp_path, capfd):
    path = tmp_path / "shared.yaml"
    path.write_text(FOREIGN)
    node, parameters = declare("--params-file", str(path))
    assert (parameters.config.k_p, parameters.config.k_max) == (1.5, 5.0)
    assert "ignored the unknown parameter 'arm_gain'" in capfd.readouterr().err
    assert node.context.ok() and not node.has_parameter("arm_gain")
