# SPDX-License-Identifier: Apache-2.0
"""The launch file, with stand-ins for launch and launch_ros, which have no wheels."""

import runpy
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.processes import executable_path

FILE = config_directory().parent / "launch" / "tactile_hand.launch.py"
CONTROLLERS = ["slip_regulator", "force_optimizer", "manipulation_controller"]


class StandIn:
    """Any class of launch and launch_ros: keeps its arguments."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args, self.options = args, options

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a LaunchConfiguration."""
        return context[self.args[0]]


def launched(**arguments: str) -> list[dict[str, Any]]:
    """Return the options of each node that the launch file starts."""
    [entities] = runpy.run_path(str(FILE))["generate_launch_description"]().args
    *declared, nodes = entities
    context = {each.args[0]: each.options["default_value"] for each in declared}
    assert set(arguments) <= set(context)
    return [node.options for node in nodes.options["function"](context | arguments)]


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Install the stand-ins, and write below the folder of the test."""
    names = "LaunchContext LaunchDescription DeclareLaunchArgument OpaqueFunction "
    names += "LaunchConfiguration Node"
    module = SimpleNamespace(**{name: StandIn for name in names.split()})
    for name in ("launch", "launch.actions", "launch.substitutions", "launch_ros.actions"):
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "launch_ros", module)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def test_a_launch_starts_the_nodes_with_the_parameters_of_a_scenario():
    found = launched(scenario="human_hold", namespace="left")
    assert [node["executable"] for node in found] == ["plant", "tactile_sensor", *CONTROLLERS]
    for node in found:
        assert executable_path(node["executable"]).is_file()
        assert node["package"] == "tactile_hand_ros" and node["namespace"] == "left"
        [(name, content)] = yaml.safe_load(Path(*node["parameters"]).read_text()).items()
        assert name == f"/**/{node['executable']}"
        assert content["ros__parameters"]["hand"] == "human"
        assert content["ros__parameters"].get("duration", 0.0) == 0.0


def test_drivers_may_replace_the_simulation():
    assert [node["executable"] for node in launched(simulation="false")] == CONTROLLERS


@pytest.mark.parametrize("word", ["True", "TRUE"])
def test_the_simulation_may_be_asked_for_as_python_writes_it(word):
    found = launched(simulation=word)
    assert [node["executable"] for node in found] == ["plant", "tactile_sensor", *CONTROLLERS]


def test_an_unknown_scenario_is_refused():
    with pytest.raises(ConfigurationError, match="no-such"):
        launched(scenario="no-such")
