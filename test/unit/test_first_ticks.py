# SPDX-License-Identifier: Apache-2.0
"""A node has loaded its compiled code before its first tick, so that no tick waits for it."""

import os
import pickle
import subprocess
import sys
from unittest.mock import Mock

import pytest

from bench.processes import isolated_domain, parameter_files
from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

TICKS = 60
BLOCKS = {
    names.REGULATOR: "SlipRegulatorNode",
    names.OPTIMIZER: "ForceOptimizerNode",
    names.CONTROLLER: "ManipulationControllerNode",
}
STEPS = """
import importlib, pickle, sys
import rclpy

def loaded():
    own = [m for name, m in list(sys.modules.items()) if name.startswith("tactile_hand_ros")]
    functions = (f for m in own for f in vars(m).values())
    return {(f.__name__, s) for f in functions for s in getattr(f, "signatures", ())}

module, kind, file, *arguments = sys.argv[1:]
rclpy.init(args=["--ros-args", *arguments])
node = getattr(importlib.import_module(f"tactile_hand_ros.nodes.{module}"), kind)(composed=True)
with open(file, "rb") as stored:
    inputs = pickle.load(stored)
before = loaded()
for each in inputs:
    node.step(*each)
print(len(before), sorted({name for name, _ in loaded() - before}))
"""


def inputs(scenario: Scenario) -> dict[str, list[tuple]]:
    """Return the arguments of the blocks at the first ticks of a run."""
    loop = ClosedLoop(scenario)
    blocks = list(zip(BLOCKS, (loop.regulator, loop.optimizer, loop.controller), strict=True))
    for _, block in blocks:
        block.step = Mock(wraps=block.step)
    loop.run(TICKS)
    return {name: [call.args for call in block.step.call_args_list] for name, block in blocks}


@pytest.mark.parametrize("scenario", ["paper", "human_pull"])
def test_no_tick_loads_compiled_code(scenario, tmp_path):
    ensure_compiled()
    chosen = load_scenario(scenario)
    with isolated_domain() as domain:
        for name, each in inputs(chosen).items():
            assert len(each) == TICKS
            file = tmp_path / f"{name}.pickle"
            file.write_bytes(pickle.dumps(each))
            files = parameter_files(chosen, tmp_path, [name])
            done = subprocess.run(
                [sys.executable, "-c", STEPS, name, BLOCKS[name], str(file), *files],
                cwd=tmp_path,  # here `-c` would take the tree for the installed package
                capture_output=True,
                text=True,
                timeout=120,
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
            )
            assert done.returncode == 0, done.stderr
            count, new = done.stdout.split(maxsplit=1)
            assert int(count) > 0 and new.strip() == "[]", name
