# SPDX-License-Identifier: Apache-2.0
"""A bag records the versions of the software that wrote it."""

import platform
from importlib import metadata

import numpy as np

import tactile_hand_ros
from tactile_hand_ros.bag import provenance as module


def test_package_python_distribution_libraries_and_the_scenario_if_there_is_one(monkeypatch):
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert module.versions()["ros_distro"] == "jazzy"
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    monkeypatch.setattr(module, "_LIBRARIES", ("no_such_library", *module._LIBRARIES))
    found = {
        "tactile_hand_ros": tactile_hand_ros.__version__,
        "python": platform.python_version(),
        "ros_distro": "kilted",
        "rclpy": metadata.version("rclpy"),
        "numpy": np.__version__,
        "osqp": metadata.version("osqp"),
        "pin": metadata.version("pin"),
    }
    assert module.versions() == found
    texts = {f"version_{name}": text for name, text in found.items()}
    assert module.provenance("") == texts
    assert module.provenance("name: x") == {"scenario": "name: x"} | texts
