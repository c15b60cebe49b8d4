# SPDX-License-Identifier: Apache-2.0
"""Run directories are unique, linked, and hold a scenario for another run."""

import datetime
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml

from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.scenario.scenario import load_scenario

NOON = datetime.datetime(2030, 1, 2, 12, 0, 0)


@pytest.mark.parametrize("name", scenario_names())
def test_resolved_scenario_loads_back_to_the_same_values(name, tmp_path):
    scenario = load_scenario(name, {"seed": 7, "plant.object.friction": 0.5})
    path = RunDirectory(tmp_path).scenario
    text = RunDirectory(tmp_path).write_scenario(scenario)
    data = yaml.safe_load(text)
    assert path.read_text() == text and "extends" not in data
    assert data["seed"] == 7 and "seed" not in data["tactile_sensor"]
    assert load_scenario(str(path)) == scenario


def test_folders_above_are_made_no_name_leaves_them_and_latest_is_the_newest(tmp_path):
    root = tmp_path / "a" / "b"
    runs = [RunDirectory.create(root, "../pull it", NOON) for _ in range(3)]
    stem = "20300102-120000-.._pull_it"
    assert [run.path.name for run in runs] == [stem, f"{stem}-2", f"{stem}-3"]
    assert (root / "latest").resolve() == runs[-1].path.resolve()
    assert runs[0].log("plant") == root / stem / "logs" / "plant.log"
    path = runs[0].write_parameters("plant", load_scenario("paper").plant)
    content = yaml.safe_load(path.read_text())  # in any namespace
    assert content["/**/plant"]["ros__parameters"]["rate"] == 500.0


def test_root_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "runs").touch()
    with pytest.raises(ConfigurationError, match="choose another --out"):
        RunDirectory.create(tmp_path / "runs", "paper")


def test_a_file_system_without_links_has_no_latest(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "symlink_to", Mock(side_effect=PermissionError(1, "no links")))
    runs = [RunDirectory.create(tmp_path, "paper", NOON) for _ in range(2)]
    assert sorted(tmp_path.iterdir()) == [run.path for run in runs]
    assert (runs[1].path / "logs").is_dir() and (runs[1].path / "parameters").is_dir()
