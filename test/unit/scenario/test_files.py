# SPDX-License-Identifier: Apache-2.0
"""Scenario files as plain data: merged, changed by keys, and their limits."""

import pytest
import yaml

from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.scenario.files import merged, put_changes, read_layers
from tactile_hand_ros.scenario.scenario import load_scenario


def test_mappings_are_laid_over_each_other_and_all_else_is_replaced():
    under = {"a": {"b": 1, "c": {"d": 2, "e": 3}}, "f": [1, 2], "g": {"h": 4}, "i": 5}
    over = {"a": {"c": {"d": 6}}, "f": [7], "g": 8, "i": {"j": 9}}
    expected = {"a": {"b": 1, "c": {"d": 6, "e": 3}}, "f": [7], "g": 8, "i": {"j": 9}}
    assert merged(under, over) == expected
    assert under["a"] == {"b": 1, "c": {"d": 2, "e": 3}}


def test_a_law_may_be_named_in_four_ways(tmp_path):
    path = tmp_path / "mine.yaml"
    for text in (
        "law: contact\n",
        "law: {name: contact}\n",
        "manipulation_controller: {law: contact}\n",
        "manipulation_controller: {law: {name: contact}}\n",
    ):
        path.write_text(text)
        law = {"name": "contact", "folder": ""}
        assert read_layers(path) == {"manipulation_controller": {"law": law}}
    path.write_text("law: contact\nmanipulation_controller: {law: contact}\n")
    with pytest.raises(ConfigurationError, match="'law' is given twice, at the top and in"):
        read_layers(path)
    for text in ("law: contact\nmanipulation_controller: 7\n", "law: 7\n"):
        path.write_text(text)
        with pytest.raises(ConfigurationError, match="is 7, but should be a valid dictionary"):
            load_scenario(str(path))


def test_an_inertia_is_inherited_only_with_its_body(tmp_path):
    path, papers = tmp_path / "mine.yaml", [0.0014, 0.0014, 0.0014]
    own, other = [1e-6, 2e-6, 2.5e-6], "plant: {object: {%s}}\n"
    for changes, inertia in (
        ("size: [0.2604, 0.2604, 0.25]", []),
        ("shape: sphere, mass: 0.002", []),
        (f"size: [0.2604, 0.2604, 0.25], inertia: {own}", own),
        ("mass: 0.002", papers),
    ):
        path.write_text("extends: paper\n" + other % changes)
        assert load_scenario(str(path)).plant.object.inertia == inertia, changes
    assert load_scenario("paper").plant.object.inertia == papers


def test_a_mesh_is_next_to_the_scenario_or_below_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "base.yaml").write_text("plant: {object: {mesh: parts/mug.stl, scale: 0.001}}\n")
    (tmp_path / "deep").mkdir()
    path, inherited = tmp_path / "deep" / "mine.yaml", str(tmp_path / "parts" / "mug.stl")
    path.write_text("extends: ../base.yaml\nplant: {object: {mass: 0.3}}\n")
    data = read_layers(path)
    assert data["plant"]["object"] == {"mesh": inherited, "scale": 0.001, "mass": 0.3}
    monkeypatch.chdir(tmp_path)
    put_changes(data, {"plant.object.mesh": "cup.obj"})
    assert data["plant"]["object"]["mesh"] == str(tmp_path / "cup.obj")
    for text in ('plant: {object: {mesh: ""}}', "plant: 7", "plant: {object: 7}"):
        path.write_text(text)
        assert read_layers(path) == yaml.safe_load(text)


def test_changes_are_put_where_their_keys_say():
    data = {"hand": "paper", "layout": "pinch", "plant": {"rate": 1.0}}
    changes = {"plant.rate": 2.0, "plant.object.mass": 3.0, "law.k_p": 4.0, "seed": 5}
    put_changes(data, changes)
    assert data == {
        "hand": "paper",
        "layout": "pinch",
        "plant": {"rate": 2.0, "object": {"mass": 3.0}},
        "manipulation_controller": {"law": {"k_p": 4.0}},
        "seed": 5,
    }
    put_changes(data, {"law": "contact", "layout": "three_faces", "hand": "other"})
    assert (data["hand"], data["layout"]) == ("other", "three_faces")  # the hand came first
    law = {"k_p": 4.0, "folder": "", "name": "contact"}
    assert data["manipulation_controller"]["law"] == law
    put_changes(data, {"hand": "other"})
    assert data["layout"] == "three_faces"
    put_changes(data, {"hand": "paper"})
    assert "layout" not in data
    with pytest.raises(ConfigurationError, match="'seed.a.b' cannot be set: 'seed' has no 'a'"):
        put_changes(data, {"seed.a.b": 1})


USERS = {"mode", "grasp_force", "maximum"}  # user settings of the regulator


@pytest.mark.parametrize("base", ["gravity", "human_hold"])
def test_no_controller_is_made_for_a_mass_or_friction_that_a_hand_cannot_know(base):
    """Scenarios of a family differ in their events, not in the control of the hand."""

    def control(name):
        scenario, derived = load_scenario(name), {"grasp_force_limit", "imu"}
        regulator = scenario.slip_regulator.model_dump(exclude=USERS)
        controller = scenario.manipulation_controller.model_dump(exclude=derived)
        return regulator, scenario.force_optimizer.model_dump(), controller

    files = find_file("scenario", base).parent
    family = [file.stem for file in files.glob("*.yaml") if extends(file.stem, base)]
    assert len(family) > 2
    for name in family:
        assert control(name) == control(base), name


def extends(name, base):
    """Whether a scenario extends another one, directly or not, with its hand."""
    parent = yaml.safe_load(find_file("scenario", name).read_text("utf-8")).get("extends", "")
    same_hand = parent and load_scenario(name).hand == load_scenario(base).hand
    return bool(same_hand) and (parent == base or extends(parent, base))
