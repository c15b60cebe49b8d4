# SPDX-License-Identifier: Apache-2.0
"""Run directories are unique, linked, and hold a scenario that can be run again."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest
import yaml

from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.scenario.scenario import load_scenario, resolved

NOON = datetime.datetime(2030, 1, 2, 12, 0, 0)


@pytest.mark.parametrize("name", scenario_names())
def test_resolved_scenario_loads_back_to_the_same_values(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name, {"seed": 7, "plant.object.friction": 0.5})
    path = RunDirectory(tmp_path).scenario
    text = RunDirectory(tmp_path).write_scenario(scenario)
    assert path.read_text() == text
    assert "extends" not in yaml.safe_load(text)
    assert load_scenario(str(path)) == scenario


def test_shared_values_are_said_once() -> None:
    data = yaml.safe_load(resolved(load_scenario("paper", {"seed": 3})))
    assert data["seed"] == 3
    assert "seed" not in data["tactile_sensor"]


def test_name_of_a_scenario_cannot_leave_the_root(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path, "../a b", NOON)
    assert run.path.parent == tmp_path
    assert run.path.name == "20300102-120000-.._a_b"


def test_root_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    with pytest.raises(ConfigurationError, match="choose another --out"):
        RunDirectory.create(tmp_path / "runs", "paper")


def test_parameters_are_of_the_node_in_any_namespace(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path, "paper", NOON)
    path = run.write_parameters("plant", load_scenario("paper").plant)
    content = yaml.safe_load(path.read_text())
    assert content["/**/plant"]["ros__parameters"]["rate"] == 500.0


def test_folders_above_are_made_and_latest_names_the_newest(tmp_path: Path) -> None:
    root = tmp_path / "a" / "b"
    now = datetime.datetime(2026, 1, 2, 3, 4, 5)
    runs = [RunDirectory.create(root, "pull it/now", now) for _ in range(3)]
    stem = "20260102-030405-pull_it_now"
    assert [run.path.name for run in runs] == [stem, f"{stem}-2", f"{stem}-3"]
    assert (root / "latest").resolve() == runs[-1].path.resolve()
    assert (runs[0].path / "logs").is_dir() and (runs[0].path / "parameters").is_dir()
    assert runs[0].log("plant") == runs[0].path / "logs" / "plant.log"
