# SPDX-License-Identifier: Apache-2.0
"""An executable loads only the libraries that it needs, because seven start at the same time."""

import subprocess
import sys

import pytest

from tactile_hand_ros.ros.processes import executable_path

FIGURES = {"matplotlib", "rosbags", "tactile_hand_ros.run", "tactile_hand_ros.report"}
COMMANDS = {"typer", "rich"}
MODEL = {"pinocchio", "tactile_hand_ros.hand.hand"}
SOLVER = {"osqp", "tactile_hand_ros.control.optimizer.quadratic_program"}
PLANT = {"tactile_hand_ros.simulation.plant"}
COMPILER = {"numba", "llvmlite"}
NODE = FIGURES | COMMANDS

UNNEEDED = {
    "plant": NODE | SOLVER,
    "tactile_sensor": NODE | MODEL | SOLVER | PLANT,
    "slip_regulator": NODE | SOLVER | PLANT,
    "force_optimizer": NODE | MODEL | PLANT,
    "manipulation_controller": NODE | SOLVER | PLANT,
    "recorder": NODE | MODEL | SOLVER | PLANT | COMPILER,
    "composed": NODE,
    "controllers": NODE,
    "driver_output": NODE | SOLVER | PLANT,
    # It checks the scenario, but a single call need not be compiled.
    "orchestrator": FIGURES | COMPILER,
}


# The orchestrator imports the parts for a run only when there is one.
EXECUTE = (
    "from tactile_hand_ros.compiled import run_interpreted; run_interpreted();"
    "import tactile_hand_ros.orchestrator.execute"
)


@pytest.mark.parametrize("name", UNNEEDED)
def test_an_executable_loads_only_what_it_needs(name):
    what = ["-c", EXECUTE] if name == "orchestrator" else [str(executable_path(name)), "--help"]
    command = [sys.executable, "-X", "importtime", *what]
    # In the root folder, or `-c` would take the tree for the installed package.
    options = {"cwd": "/", "capture_output": True, "text": True, "check": True, "timeout": 120}
    lines = subprocess.run(command, **options).stderr.splitlines()
    imported = (line for line in lines if line.startswith("import time:"))
    found = {line.rpartition("|")[2].strip() for line in imported}
    assert "rclpy" in found and "tactile_hand_ros.config.model" in found
    assert not found & UNNEEDED[name]
