# SPDX-License-Identifier: Apache-2.0
"""A bag records the versions of the software that wrote it."""

import platform
from importlib import metadata

import numpy as np

import tactile_hand_ros
from tactile_hand_ros.bag import provenance as module
from tactile_hand_ros.bag.provenance import provenance, versions


def test_package_python_distribution_and_libraries(monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    found = versions()
    assert found["tactile_hand_ros"] == tactile_hand_ros.__version__
    assert (found["python"], found["ros_distro"]) == (platform.python_version(), "kilted")
    assert (found["numpy"], found["osqp"]) == (np.__version__, metadata.version("osqp"))
    monkeypatch.delenv("ROS_DISTRO")
    assert versions()["ros_distro"] == "jazzy"


def test_a_library_that_leaves_no_metadata_is_left_out(monkeypatch):
    monkeypatch.setattr(module, "_LIBRARIES", ("no_such_library", "numpy"))
    assert [*versions()][-1] == "numpy" and "no_such_library" not in versions()


def test_the_scenario_is_there_if_there_was_one():
    assert provenance("name: x") == {"scenario": "name: x"} | provenance("")
    assert provenance("")["version_numpy"] == np.__version__ and "scenario" not in provenance("")
