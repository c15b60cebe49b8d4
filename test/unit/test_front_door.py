# SPDX-License-Identifier: Apache-2.0
"""The package's public names are few, documented, and free until first use."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.recorded import write_record

import tactile_hand_ros
from tactile_hand_ros import simulate
from tactile_hand_ros.control.laws import OptimalLaw
from tactile_hand_ros.errors import ConfigurationError


@pytest.mark.parametrize("name", tactile_hand_ros.__all__)
def test_a_public_name_can_be_loaded_and_is_documented(name):
    assert getattr(tactile_hand_ros, name).__doc__
    assert name in dir(tactile_hand_ros) and name in vars(tactile_hand_ros)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'Foot'"):
        tactile_hand_ros.Foot


def test_importing_the_package_loads_nothing_else(tmp_path):
    code = "import sys, tactile_hand_ros; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    loaded = subprocess.check_output(command, cwd=tmp_path, text=True).split()
    assert {"numpy", "rclpy", "pydantic"}.isdisjoint(loaded)
    assert [name for name in loaded if name.startswith("tactile_hand_ros.")] == []


SHORT = {"duration": 0.1, "targets": []}


class Firmer(OptimalLaw):
    """A user law, defined where it is used."""

    def internal_torque(self) -> np.ndarray:
        return 1.5 * super().internal_torque()


def test_a_law_is_given_as_a_class_or_by_name():
    plain, own = simulate("paper", SHORT), simulate("paper", SHORT, law=Firmer)
    assert not np.array_equal(plain.record.command, own.record.command)
    assert own.scenario is not None
    assert own.scenario.manipulation_controller.law.name == f"{__name__}:Firmer"
    named = simulate("paper", SHORT, law="contact").scenario
    assert named is not None and named.manipulation_controller.law.name == "contact"
    with pytest.raises(ConfigurationError, match="it has no internal_torque"):
        simulate("paper", SHORT, law=int)


def test_the_examples_in_docstrings_give_their_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_record(Path("runs/latest/bag"), simulate("paper", SHORT).record)
    for name in ("front_door", "sweep", "run.run", "run.metrics", "control.laws"):
        found = doctest.testmod(importlib.import_module(f"tactile_hand_ros.{name}"))
        assert found.attempted and not found.failed, name
