# SPDX-License-Identifier: Apache-2.0
"""Fields of a configuration as ROS parameters: types, closed ranges, text for files."""

from __future__ import annotations

from typing import Any, Literal

import pytest
import yaml
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from tactile_hand_ros.config.model import Config, leaves, param
from tactile_hand_ros.ros.parameters import (
    descriptor,
    from_ros,
    ros_type,
    to_parameters,
    to_params_yaml,
    with_known_types,
)

Type = Parameter.Type


class Part(Config):
    kind: Literal["a", "b"] = param("a", "Kind")


class Fields(Config):
    free: float = param(1.0, "Free")
    above: float = param(1.0, "Above", gt=0.5)
    below: float = param(1.0, "Below", unit="m", lt=2.5)
    between: float = param(1.0, "", unit="N", ge=-1.5, le=1.5)
    many: int = param(3, "Many")
    more: int = param(3, "More", gt=2)
    fewer: int = param(3, "Fewer", lt=8)
    some: int = param(3, "Some", ge=1, le=9)
    words: list[str] = param(["1", "on"], "Words")
    parts: list[Part] = param([Part()], "Parts")
    part: Part = Part()


FIELDS = leaves(Fields)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("free", []),
        ("above", [(0.5, float("inf"))]),
        ("below", [(-float("inf"), 2.5)]),
        ("between", [(-1.5, 1.5)]),
    ],
)
def test_a_range_of_real_numbers_is_closed_at_its_bounds(name: str, expected: list[Any]) -> None:
    shown = descriptor(FIELDS[name])
    ranges = [(each.from_value, each.to_value) for each in shown.floating_point_range]
    assert ranges == expected and list(shown.integer_range) == []


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("many", []),
        ("more", [(3, 2**63 - 1, 1)]),
        ("fewer", [(-(2**63), 7, 1)]),
        ("some", [(1, 9, 1)]),
    ],
)
def test_a_range_of_integers_excludes_an_open_end(name: str, expected: list[Any]) -> None:
    shown = descriptor(FIELDS[name])
    ranges = [(each.from_value, each.to_value, each.step) for each in shown.integer_range]
    assert ranges == expected and list(shown.floating_point_range) == []


def test_a_description_has_a_unit_where_there_is_one() -> None:
    texts = {name: descriptor(FIELDS[name]).description for name in ("free", "below", "between")}
    assert texts == {"free": "Free", "below": "Below [m]", "between": " [N]"}
    assert [descriptor(FIELDS["free"], read_only=each).read_only for each in (False, True)] == [
        False,
        True,
    ]


def test_types_are_those_of_ros() -> None:
    expected = {
        "free": Type.DOUBLE,
        "many": Type.INTEGER,
        "words": Type.STRING_ARRAY,
        "parts": Type.STRING_ARRAY,
        "part.kind": Type.STRING,
    }
    assert {name: ros_type(FIELDS[name]) for name in expected} == expected


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("free", 2, 2.0),
        ("free", True, True),  # no number: the model refuses it
        ("many", 2, 2),
        ("words", None, []),
        ("words", ("a", "b"), ["a", "b"]),
        ("words", "ab", "ab"),
        ("parts", ["{kind: b}"], [{"kind": "b"}]),
        ("parts", "{kind: b}", "{kind: b}"),
    ],
)
def test_a_value_of_ros_is_what_the_field_takes(name: str, value: Any, expected: Any) -> None:
    found = from_ros(FIELDS[name], value)
    assert found == expected and type(found) is type(expected)


def test_all_values_become_messages_in_their_order() -> None:
    made = to_parameters(Fields(many=7, parts=[Part(kind="b")]))
    assert [each.name for each in made] == list(FIELDS)
    values = {each.name: each.value for each in made}
    assert values["many"].integer_value == 7 and values["between"].double_value == 1.0
    assert list(values["parts"].string_array_value) == ["{kind: b}"]


def test_a_file_keeps_what_looks_like_a_number_a_text() -> None:
    text = to_params_yaml(Fields(), "node")
    assert "'1'" in text and "'on'" in text
    parameters = yaml.safe_load(text)["/**/node"]["ros__parameters"]
    assert parameters["words"] == ["1", "on"] and parameters["part"] == {"kind": "a"}
    assert list(yaml.safe_load(to_params_yaml(Fields()))) == ["/**"]
    long = Fields(words=["a b " * 300])
    assert max(map(len, to_params_yaml(long).splitlines())) > 1200  # rcl joins no lines


def parameter(name: str, kind: int) -> ParameterMessage:
    return ParameterMessage(name=name, value=ParameterValue(type=kind))


def test_of_several_parameters_each_is_judged_or_all_together() -> None:
    """The callback of rclpy sees those only whose types it knows."""
    asked: list[list[str]] = []
    yes = SetParametersResult(successful=True)

    def each(request: Any, response: Any) -> Any:
        asked.append([p.name for p in request.parameters])
        response.results = [yes for _ in request.parameters]
        return response

    def together(request: Any, response: Any) -> Any:
        asked.append([p.name for p in request.parameters])
        response.result = yes
        return response

    mixed = [parameter("a", 3), parameter("b" * 90, 77), parameter("c", 9)]
    one = with_known_types(SetParameters, each)
    answer = one(SetParameters.Request(parameters=mixed), SetParameters.Response())
    assert [result.successful for result in answer.results] == [True, False, True]
    assert asked == [["a"], ["c"]]
    assert f"'{'b' * 80}' has type 77" in answer.results[1].reason
    asked.clear()
    both = with_known_types(SetParametersAtomically, together)
    for parameters, well in ((mixed, False), ([mixed[0], mixed[2]], True)):
        request = SetParametersAtomically.Request(parameters=parameters)
        assert both(request, SetParametersAtomically.Response()).result.successful is well
    assert asked == [["a", "c"]]
    assert with_known_types(Trigger, each) is each
