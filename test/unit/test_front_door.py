# SPDX-License-Identifier: Apache-2.0
"""The package's public names are few, documented, and cost nothing until they are used."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import tactile_hand_ros
from tactile_hand_ros import ClosedLoop, load_scenario, metrics


@pytest.mark.parametrize("name", tactile_hand_ros.__all__)
def test_a_public_name_can_be_loaded_and_is_documented(name: str) -> None:
    assert getattr(tactile_hand_ros, name).__doc__
    assert name in dir(tactile_hand_ros) and name in vars(tactile_hand_ros)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Foot'"):
        tactile_hand_ros.Foot


def test_importing_the_package_loads_nothing_else(tmp_path: Path) -> None:
    code = "import sys, tactile_hand_ros; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    loaded = done.stdout.split()
    assert {"numpy", "rclpy", "pydantic"}.isdisjoint(loaded)
    assert [name for name in loaded if name.startswith("tactile_hand_ros.")] == []


def test_three_names_run_the_paper() -> None:
    scenario = load_scenario("paper", {"duration": 0.2, "targets": []})
    record = ClosedLoop(scenario).run()
    assert metrics(record, scenario).contacts_lost_ticks == 0
