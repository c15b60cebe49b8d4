# SPDX-License-Identifier: Apache-2.0
"""The YAML file of a hand: valid content, and how a hand is found."""

from typing import Any

import pytest

from tactile_hand_ros.config.hand_config import HandConfig, MountConfig, load_hand_config
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.errors import ConfigurationError, HandModelError


def hand(names: list[str], **more: Any) -> HandConfig:
    fingers = [
        {"name": name, "tip": f"{name}_tip", "radius": 0.01 * (i + 1)}
        for i, name in enumerate(names)
    ]
    return validate(HandConfig, {"urdf": "hand.urdf", "fingers": fingers, **more})


@pytest.mark.parametrize(
    ("fingers", "message"),
    [
        (["thumb"] * 3, "^fingers.0. is 'thumb', but should be a valid dictionary"),
        ({"thumb": {"tip": "a"}}, "^fingers is {'thumb': {'tip': 'a'}}, but should be a"),
        ([{"name": f"f{i}", "tip": "t"} for i in range(33)], "at most 32 items"),
        ([{"name": "f", "tip": "t"}], "at least 2 items"),
    ],
)
def test_fingers_of_another_form_or_number_are_refused_in_one_sentence(fingers, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        validate(HandConfig, {"urdf": "hand.urdf", "fingers": fingers})
    assert "\n" not in str(caught.value)


def test_an_axis_that_points_nowhere_is_refused_in_one_sentence():
    fingers = [{"name": name, "tip": "t", "axis": [0.0, 0.0, -1e-3]} for name in "ab"]
    assert hand([], fingers=fingers).fingers[1].axis == (0.0, 0.0, -1e-3)
    fingers[1]["axis"] = [0, 0, 0]
    with pytest.raises(ConfigurationError, match=r"fingers.1..axis is .*: axis is 0") as caught:
        hand([], fingers=fingers)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["", "1a", "a-b", "a b", "é", "a" * 61, "a\n"])
def test_a_name_that_is_no_part_of_a_topic_or_given_twice_is_refused(name):
    with pytest.raises(ConfigurationError, match="is .*, but should match pattern"):
        hand([name, "b", "c"])
    hand(["a" * 60, "b", "c"])
    with pytest.raises(ConfigurationError, match="finger names must differ, got a, b, a"):
        hand(["a", "b", "a"])


def test_layouts_are_chosen_by_name_or_by_default():
    layouts = {"wide": {"base": {"xyz": [0.1, 0.0, 0.0]}}, "narrow": {"base": {}}}
    config = hand(["a", "b", "c"], layouts=layouts, default_layout="narrow")
    assert config.layout("wide")["base"].xyz == (0.1, 0.0, 0.0)
    assert config.layout() == config.layout("narrow") == {"base": MountConfig()}
    with pytest.raises(HandModelError, match="no layout 'tall'; use one of: wide, narrow"):
        config.layout("tall")
    assert hand(["a", "b", "c"], layouts=layouts).layout() == {}


def test_a_hand_is_a_file_or_one_of_those_that_come_with_the_package(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    for suffix in (".yaml", ".yml"):
        file = tmp_path / f"mine{suffix}"
        file.write_text("urdf: a\nfingers: [{name: a, tip: a}, {name: b, tip: b}]")
        assert find_file("hand", str(file)) == file
        assert load_hand_config(str(file)).folder == tmp_path.resolve()
        assert find_file("hand", f"~/mine{suffix}") == file
        with pytest.raises(ConfigurationError, match="gone.* does not exist"):
            find_file("hand", str(tmp_path / f"gone{suffix}"))
    paper = find_file("hand", "paper")
    assert paper.name == "paper.yaml" and load_hand_config("paper").folder == paper.resolve().parent
    with pytest.raises(ConfigurationError, match="no hand is called 'papr', did you mean 'paper'"):
        find_file("hand", "papr")
