# SPDX-License-Identifier: Apache-2.0
"""Configuration is immutable and finite; errors give place and reason."""

import enum
import math
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from tactile_hand_ros.config.model import Config, flatten, from_flat, leaves, param, validate
from tactile_hand_ros.config.plain_yaml import parse_changes, read_yaml
from tactile_hand_ros.errors import ConfigurationError


class Law(str, enum.Enum):
    PROPOSED = "proposed"
    KAWAMURA = "kawamura"


class Body(Config):
    mass: float = param(0.1, "Mass", unit="kg", gt=0.0)
    size: float = param(0.2, "Edge", unit="m", gt=0.0, le=1.0)


class Push(Config):
    kind: Literal["step", "ramp"] = param("step", "Shape over time")
    start: float = param(..., "Start", unit="s", ge=0.0)


class Example(Config):
    body: Body = Body()
    law: Law = param(Law.PROPOSED, "Control law", live=True)
    gains: tuple[Annotated[float, Field(ge=0.0)], ...] = param((1.0, 2.0), "Gains", live=True)
    fingers: int = param(3, "Number of fingers", ge=3)
    limit: float | None = param(None, "Limit", unit="N")
    noisy: bool = param(False, "Whether there is noise")
    pushes: tuple[Push, ...] = param((), "Disturbances")

    @model_validator(mode="after")
    def _consistent(self):
        if self.noisy and self.fingers > 4:
            raise ValueError("noise is supported for up to 4 fingers, take fewer")
        return self


def load(tmp_path, text):
    path = tmp_path / "example.yaml"
    path.write_text(text)
    return validate(Example, read_yaml(path), str(path))


def test_values_are_read_into_their_types(tmp_path):
    config = load(
        tmp_path,
        "body: {mass: 1e-3}\nlaw: kawamura\ngains: [1, 2.5]\npushes:\n- {kind: ramp, start: 2}\n",
    )
    assert config.body == Body(mass=0.001)
    assert config.law is Law.KAWAMURA
    assert config.gains == (1.0, 2.5)
    assert config.pushes == (Push(kind="ramp", start=2.0),)
    assert load(tmp_path, "# nothing\n") == Example()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("body: {mas: 1}", ["'mas' in body", "did you mean 'mass'?", "mass, size"]),
        ("body: {mass: -1}", [": body.mass is -1", "should be greater than 0 [kg]"]),
        ("body: {size: 1.5}", [": body.size is 1.5", "should be less than or equal to 1 [m]"]),
        ("law: best", [": law is 'best'", "'proposed' or 'kawamura'"]),
        ("gains: [1, .nan]", [": gains[1] is nan", "finite number"]),
        ("gains: [1, -2]", [": gains[1] is -2", "greater than or equal to 0"]),
        ("body: {mass: true}", [": body.mass is invalid", "true or false is not a number"]),
        ("fingers: four", [": fingers is 'four'", "should be a valid integer"]),
        ("noisy: perhaps", [": noisy is 'perhaps'", "should be a valid boolean"]),
        ("pushes: [{kind: shove, start: 1}]", [": pushes[0].kind is 'shove'", "'step' or 'ramp'"]),
        ("pushes: [{knd: step, start: 1}]", ["'knd' in pushes[0]", "did you mean 'kind'"]),
        ("- 1", [": the content is [1]", "should be a valid dictionary"]),
        ("noisy: true\nfingers: 5", [": noise is supported for up to 4 fingers"]),
        ("law: [", [": line 1", "not valid YAML"]),
        ("law: {[1, 2]: 3}", [": line 1, column 7", "unhashable key"]),
        ("law: 2024-13-01", [": this file is not valid YAML: month must be in 1..12"]),
        ("law: !!python/object:os.system ''", [": line 1", "could not determine a constructor"]),
        ("gains: " + 50_000 * "[", [": this file", "recursion"]),
        ("fingers: 1\nlaw: best\n", [": law is 'best'"]),  # the first mistake
        ("x: 1", ["unknown key 'x'. Valid are: body, fingers, gains, law, limit, noisy, pushes."]),
        ("limit: x", [": limit is 'x', but should be a valid number, unable to parse", "[N]."]),
        ("pushes: [{}]", [": pushes[0].start is missing, expected the Start [s]."]),
    ],
)
def test_a_wrong_key_or_value_is_refused_with_its_place(tmp_path, text, words):
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'example.yaml'}: ")
    for word in words:
        assert word in message
    assert "\n" not in message and message.endswith(".")


def test_a_configuration_cannot_be_changed_in_place():
    with pytest.raises(ValidationError):
        Example().fingers = 4


def test_flat_and_nested_forms_are_equal():
    config = Example(body=Body(mass=2.0), pushes=(Push(start=1.0),))
    assert list(flatten(config)) == list(leaves(Example))
    assert flatten(config)["body.mass"] == 2.0
    assert from_flat(Example, flatten(config)) == config


def test_changed_returns_a_validated_copy():
    config = Example()
    assert config.changed({"body.mass": 2.0}).body.mass == 2.0
    assert config.body.mass == 0.1
    with pytest.raises(ConfigurationError, match="body.mass is -2"):
        config.changed({"body.mass": -2.0})


def test_changes_of_a_command_line_have_a_key_and_a_value():
    assert parse_changes(["a=1", "b=c=d", "e=''"]) == {"a": 1, "b": "c=d", "e": ""}
    for wrong in ("a", "=1", "", "=", "a=", "a= "):
        with pytest.raises(ConfigurationError, match="expected key=value such as plant.rate=250"):
            parse_changes([wrong])
    with pytest.raises(ConfigurationError, match="--set a: line 1"):
        parse_changes(["a=["])


def test_a_key_below_a_value_is_unknown():
    for key in ("fingers.x", "fingers.x.y"):
        with pytest.raises(ConfigurationError, match=f"^there: unknown key '{key}'"):
            from_flat(Example, {"fingers": 3, key: 1}, "there")


class Turned(Config):
    turn: tuple[float, ...] = param((), "Turn", unit="rad")
    angle: float | None = param(None, "Angle", unit="rad")


def test_a_thousandth_beyond_a_turn_is_rounding_and_more_is_refused():
    for sign in (1.0, -1.0):
        Turned(turn=(0.0, sign * (2.0 * math.pi + 0.9999e-3), 1.0))
        with pytest.raises(ConfigurationError, match="beyond a full turn; angles are in rad"):
            validate(Turned, {"turn": [0.0, sign * (2.0 * math.pi + 1.0001e-3), 1.0]})
    with pytest.raises(ConfigurationError, match="^angle is invalid: 45.0 goes beyond a full turn"):
        validate(Turned, {"angle": 45.0})
