# SPDX-License-Identifier: Apache-2.0
"""Scenarios: the package's own are valid, and errors name the place."""

from functools import partial

import numpy as np
import pytest
from pydantic import ValidationError

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.control.laws import law_of
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import NODES, Scenario, load_scenario, resolved
from tactile_hand_ros.simulation.plant_config import PlantConfig


def load(tmp_path, text, name="mine", **changes):
    path = tmp_path / f"{name}.yaml"
    path.write_text(text)
    return load_scenario(str(path), changes)


@pytest.mark.parametrize("name", scenario_names())
def test_every_shipped_scenario_loads_and_can_work(name):
    scenario = load_scenario(name)
    assert scenario.name == name and scenario.description
    check_scenario(scenario)


def test_the_paper_is_table_one():
    paper = load_scenario("paper")
    law, body = paper.manipulation_controller.law, paper.plant.object
    assert (law.name, law.k_p, law.k_o, law.damping) == ("optimal", 3.0, 0.5, 0.07)
    assert paper.slip_regulator.grasp_force == 10.0
    assert paper.force_optimizer.weights == [10.0, 1.0, 10.0]
    assert (body.mass, body.inertia, body.size) == (0.0018, [0.0014] * 3, (0.2604,) * 3)
    assert paper.plant.initial_joints == [1.047, 0.0, 1.571]
    assert paper.plant.gravity == (0.0, 0.0, 0.0) and not paper.plant.disturbances
    assert (paper.duration, paper.layout) == (10.0, "three_faces")
    (target,) = paper.targets
    np.testing.assert_array_equal(target.target().position, [-0.1, 0.2, 0.4])
    np.testing.assert_array_equal(target.target().orientation, np.eye(3))


@pytest.mark.parametrize("node", NODES)
def test_an_empty_section_is_refused_as_it_would_hide_what_is_extended(tmp_path, node):
    with pytest.raises(ConfigurationError, match=f"'{node}' is empty"):
        load(tmp_path, f"extends: gravity\n{node}:\n")


@pytest.mark.parametrize(
    ("mode", "force", "reason"),
    [
        ("auto", 9.0, "change nothing where slip_regulator.mode is auto"),
        ("user", 61.0, "user_forces has 61 N, expected 0.5 to 60 N"),
        ("shared", 0.4, "user_forces has 0.4 N"),
    ],
)
def test_a_force_that_the_regulator_ignores_or_rejects_is_refused(mode, force, reason):
    changes = {"slip_regulator.mode": mode, "user_forces": [{"time": 0.1, "force": force}]}
    with pytest.raises(ConfigurationError, match=reason):
        load_scenario("hold", changes)
    changes["slip_regulator.mode"], changes["user_forces"][0]["force"] = "user", 60.0
    assert load_scenario("hold", changes).user_forces[0].force == 60.0


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("plant: {disturbances: [{start: 0.5}, {start: 2, force: [1, 0, 0]}]}", "plant.disturba"),
        ("plant: {friction_changes: [{start: 3, friction: 0.3}]}", "plant.friction_changes comes"),
        ("user_forces: [{time: 2, force: 9}]", "user_forces comes at 2 s, but the run ends at 2 s"),
    ],
)
def test_what_comes_after_the_end_is_refused_unless_the_run_is_cut_short(tmp_path, text, place):
    with pytest.raises(ConfigurationError, match=place):
        load(tmp_path, f"duration: 2\n{text}")
    load(tmp_path, f"duration: 4\n{text}")
    load(tmp_path, f"duration: 4\n{text}", duration=2.0)
    both = {"duration": 2.0, "user_forces": [{"time": 2.0, "force": 9.0}]}
    with pytest.raises(ConfigurationError, match="user_forces comes at 2 s"):
        load(tmp_path, "seed: 1", **both)


def test_what_is_said_once_reaches_every_node(tmp_path):
    scenario = load(tmp_path, "layout: pinch\nseed: 7\nduration: 2.5\n")
    assert scenario.plant.layout == scenario.manipulation_controller.layout == "pinch"
    assert scenario.tactile_sensor.seed == 7
    assert scenario.plant.duration == 2.5
    assert scenario.ticks == 1251


def test_a_finished_section_is_refused():
    """Its defaults could contradict the values shared by all nodes."""
    with pytest.raises(ValidationError, match="give 'plant' as a mapping, not as PlantConfig"):
        Scenario(plant=PlantConfig())


AT = "position: [0, 0, 0]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("plant: {objet: {}}", r"mine.yaml: unknown key 'objet' in plant, did you mean 'object'"),
        ("plant: {object: {mass: -1}}", r"mass is -1, but should be greater than 0 .kg.\.$"),
        ("plant: {object: {mass: 0.1, inertia: [1, 1, 1]}}", r"0.1 kg .* more than 0.0051 kg m\^2"),
        ("manipulation_controller: {law: {name: pid}}", r"law.name .*'pid' .*one of optimal, cont"),
        ("targets: [{position: [0, 0, 0], rotation: [0, 0, 45]}]", r"goes beyond a full turn"),
        ("targets: [{position: [0, 0, 0], rotation: held}]", r"'held' is neither .* nor keep"),
        ("plant: {object: {rotation: [0, 0, 30]}}", r"a full turn; angles are in rad"),
        ("targets: [{time: 1.0}]", r"targets\[0\].position is missing"),
        ("targets: [{position: [1, 2, x]}]", r"targets\[0\].position.*'x'.*not a number|'x'"),
        ("plant: {hand: other}", r"set 'hand' once at the top, not in 'plant'"),
        ("plant: 3", r"plant is 3, but should be a valid dictionary"),
        ("plant: 3\ntactile_sensor: {seed: 2}", r"set 'seed' once at the top, not in 'tactile"),
        ("[1, 2]", r"mine.yaml: expected keys with values; write `extends: paper`"),
        ("# nothing", r"mine.yaml: expected keys with values"),
        ("seed: -1", r"mine.yaml: seed is -1"),
        (f"targets: [{{time: 2, {AT}}}, {{time: 1, {AT}}}]", r"in order of time, got \[2.0, 1.0\]"),
        (f"duration: 1\ntargets: [{{time: 1, {AT}}}]", r"comes at 1.0 s, but the run ends at 1.0"),
        ("slip_regulator: {grasp_force: 99}", r"grasp_force = 99.0 N is outside"),
    ],
)
def test_a_mistake_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(ConfigurationError, match=message):
        load(tmp_path, text)


def test_an_extension_looks_beside_itself_first(tmp_path):
    (tmp_path / "base.yaml").write_text("extends: paper\nduration: 3.0\nname: base\n")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "other.yaml").write_text("extends: ../base.yaml\nseed: 5\n")
    for text in ("extends: base", "extends: base.yaml", "extends: sub/other.yaml"):
        scenario = load(tmp_path, text)
        assert scenario.duration == 3.0 and scenario.name == "mine"
        assert scenario.plant.object.mass == 0.0018


def test_changes_go_over_the_file_and_reach_every_node():
    paper, gravity = load_scenario("paper"), (1.0, -2.0, 3.0)
    changes = {"gravity": gravity, "plant.rate": 250.0, "targets.0.time": 0.2}
    for other in (load_scenario("paper", changes), paper.changed(changes)):
        assert other.plant.gravity == other.manipulation_controller.gravity == gravity
        assert (other.plant.rate, other.targets[0].time) == (250.0, 0.2)
    assert paper == load_scenario("paper") and paper.changed({}) == paper


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("plant.rat", 3, "unknown key 'rat'"),
        ("targets.0.time", -1, r": targets.0..time is -1"),
        ("targets.1.time", 0.2, "'targets.1.time' cannot be set"),
        ("plant.gravity", [0, 0, 0], "set 'gravity' once at the top"),
        ("law", "optimall", "did you mean 'optimal'"),
    ],
)
def test_mistakes_in_changes_are_refused_with_their_place(key, value, message):
    for change in (load_scenario("paper").changed, partial(load_scenario, "paper")):
        with pytest.raises(ConfigurationError, match=message):
            change({key: value})
    with pytest.raises(ConfigurationError, match="paper.yaml with changes of seed: seed is -1"):
        load_scenario("paper", {"seed": -1})


def test_scenarios_that_extend_each_other_are_refused(tmp_path):
    (tmp_path / "a.yaml").write_text("extends: b\n")
    (tmp_path / "b.yaml").write_text("extends: a\n")
    with pytest.raises(ConfigurationError, match="makes a loop: a -> b -> a"):
        load_scenario(str(tmp_path / "a.yaml"))
    with pytest.raises(ConfigurationError, match="is called 'papper', did you mean 'paper'"):
        load(tmp_path, "extends: papper")
    with pytest.raises(ConfigurationError, match=r"gone.yaml' does not exist.*paper"):
        load_scenario(str(tmp_path / "gone.yaml"))
    with pytest.raises(ConfigurationError, match="makes a loop: mine -> mine"):
        load(tmp_path, "extends: mine.yaml")
    # A user's own `paper` may extend that of the package.
    assert load(tmp_path, "extends: paper\nduration: 2", name="paper").duration == 2.0


def test_a_hand_lies_beside_the_file_that_names_it(tmp_path, monkeypatch):
    (tmp_path / "child").mkdir()
    monkeypatch.chdir(tmp_path)
    load(tmp_path, "extends: paper\nhand: hands/own.yaml", name="parent")
    child = load(tmp_path / "child", "extends: ../parent.yaml")
    assert child.hand == child.plant.hand == str(tmp_path / "hands" / "own.yaml")
    on_command_line = load_scenario("paper", {"hand": "here.yaml"})
    assert on_command_line.hand == str(tmp_path / "here.yaml")


def test_another_hand_drops_the_layout_that_was_for_the_old_one(tmp_path):
    assert load(tmp_path, "extends: paper\nhand: own.yaml").layout == ""
    assert load(tmp_path, "extends: paper\nhand: own.yaml\nlayout: flat").layout == "flat"
    assert load(tmp_path, "extends: paper\nhand: paper").layout == "three_faces"


def test_what_a_target_does_not_name_is_kept_as_the_hand_believes_it_then(tmp_path):
    kept = load(
        tmp_path,
        """
        extends: pinch
        duration: 3
        targets:
          - {time: 0, position: [0, 0.05, 0.41]}
          - {time: 0.02, position: keep, rotation: [0, 0, 0.1]}
          - {time: 0.04, position: [0, 0.06, 0.41], rotation: keep}
        """,
    )
    run = ClosedLoop(kept).run(21)
    for row in (0, 20):
        np.testing.assert_array_equal(run.desired_quaternion[row], run.auxiliary_quaternion[row])
    np.testing.assert_array_equal(run.desired_position[10], run.auxiliary_position[10])
    assert kept.changed({}) == kept and "null" not in resolved(kept)


def test_the_hold_squeezes_up_to_the_limit_of_the_regulator():
    def limit_of(scenario: Scenario) -> float:
        return scenario.plant.guard.hold.internal_force_limit

    assert limit_of(load_scenario("paper")) == 40.0
    assert limit_of(load_scenario("crush_limit")) == 15.0
    raised = load_scenario("crush_limit").changed({"slip_regulator.maximum": 20.0})
    assert limit_of(raised) == 20.0
    own = load_scenario("paper", {"plant.guard.hold.internal_force_limit": 12.0})
    assert limit_of(own.changed({"slip_regulator.maximum": 20.0})) == 12.0
    assert limit_of(Scenario(slip_regulator={"maximum": 30.0})) == 30.0


def test_stamps_are_whole_nanoseconds():
    target = {"time": 0.0123456789, "position": [0.0, 0.0, 0.4]}
    changes = {"targets": [target], "user_forces": [{"time": 1.1, "force": 5.0}]}
    scenario = Scenario().changed(changes)
    assert (scenario.targets[0].stamp, scenario.user_forces[0].stamp) == (12345679, 1_100_000_000)


def test_a_law_that_is_named_by_a_change_is_imported(tmp_path, monkeypatch):
    (tmp_path / "changed_law.py").write_text(
        "from tactile_hand_ros.control.laws import ContactLaw as MyLaw"
    )
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("paper").changed({"law": "changed_law:MyLaw"})
    assert scenario.manipulation_controller.law.folder == str(tmp_path)
    assert law_of(scenario.manipulation_controller.law).__name__ == "ContactLaw"
