# SPDX-License-Identifier: Apache-2.0
"""The command line: changes, namespaces, ROS arguments, and how executables are started."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix

from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.orchestrator.command import split_ros_arguments
from tactile_hand_ros.orchestrator.conduct import conduct, full_namespace, shares_process
from tactile_hand_ros.orchestrator.processes import Launcher
from tactile_hand_ros.orchestrator.request import Request
from tactile_hand_ros.orchestrator.signals import Signals
from tactile_hand_ros.ros.executables import PACKAGE, executable_path
from tactile_hand_ros.scenario.scenario import load_scenario


def test_changes_are_yaml() -> None:
    changes = parse_changes(["plant.rate=250", "targets=[{position: [0, 0, 1e-1]}]", "name=a=b"])
    assert changes == {
        "plant.rate": 250,
        "targets": [{"position": [0, 0, 0.1]}],
        "name": "a=b",
    }


@pytest.mark.parametrize("change", ["plant.rate", "=3", "a={"])
def test_what_is_no_change_is_refused(change: str) -> None:
    with pytest.raises(ConfigurationError, match="--set"):
        parse_changes([change])


@pytest.mark.parametrize(
    ("given", "arguments", "expected"),
    [
        ("", [], "/"),
        ("/", [], "/"),
        ("left", [], "/left"),
        ("/left/", [], "/left"),
        ("/a/b_2", [], "/a/b_2"),
        ("", ["x", "--ros-args", "-r", "__ns:=/right"], "/right"),
        ("left", ["x", "--ros-args", "-r", "__ns:=/right"], "/left"),
    ],
)
def test_namespace(given: str, arguments: list[str], expected: str) -> None:
    assert full_namespace(given, arguments) == expected


@pytest.mark.parametrize("given", ["1st", "a-b", "a//b", "a b"])
def test_bad_namespace_is_refused(given: str) -> None:
    with pytest.raises(ConfigurationError, match=f"'{given}'"):
        full_namespace(given, [])


def asked_for(folder: Path, **options: Any) -> Request:
    """Return a request for a run in a folder, with the options of the command line by default."""
    return Request(out=folder / "runs", **options)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"scenario": "papr"}, "did you mean 'paper'"),
        ({"scenario": "broken.yaml"}, "broken.yaml: line 3, .* is not valid YAML"),
        ({"changes": ["plant.rte=500"]}, "did you mean 'rate'"),
        ({"changes": ["targets=[{position: [9, 9, 9]}]"]}, "out of reach"),
        ({"namespace": "1st"}, "the namespace is '1st'"),
        ({"priority": 100}, "--priority is '100'"),
        ({"cpus": "all"}, "--cpus is 'all'"),
        ({"cpus": "0,9999"}, "'0,9999', but this machine has no processor 9999"),
    ],
)
def test_what_is_refused_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], complaint: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.yaml").write_text("extends: paper\nplant: {rate: 500\n")
    with pytest.raises(TactileHandError, match=complaint):
        conduct(asked_for(tmp_path, **options), Signals(), [], Launcher())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("pacing", "asked", "expected"),
    [
        ("realtime", None, True),
        ("lockstep", None, False),
        ("realtime", False, False),
        ("lockstep", True, True),
    ],
)
def test_nodes_share_a_process_in_real_time_unless_asked_otherwise(
    pacing: str, asked: bool | None, expected: bool
) -> None:
    scenario = load_scenario("paper", {"plant.pacing": pacing})
    assert shares_process(scenario, asked) is expected


def test_ros_arguments_are_taken_out() -> None:
    line = ["orchestrator", "--quiet", "--ros-args", "-r", "a:=b", "--", "--duration", "1"]
    own, ros = split_ros_arguments(line)
    assert own == ["--quiet", "--duration", "1"]
    assert ros == line
    assert split_ros_arguments(["orchestrator", "--quiet"]) == (["--quiet"], [])


def fake_ros2(folder: Path, answer: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a ``ros2`` first on PATH that answers every question in the same way."""
    command = folder / "ros2"
    command.write_text(f"#!/bin/sh\n{answer}\n")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    return command


def test_ros2_run_is_used_where_it_finds_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = fake_ros2(tmp_path, f"echo {get_package_prefix(PACKAGE)}", monkeypatch)
    assert Launcher().command("plant") == [str(command), "run", PACKAGE, "plant"]


@pytest.mark.parametrize("answer", ["exit 1", "echo /opt/elsewhere", "echo broken >&2; kill $$"])
def test_same_file_is_started_where_ros2_does_not_work(
    answer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_ros2(tmp_path, answer, monkeypatch)
    launcher = Launcher()
    assert launcher.command("plant") == [str(executable_path("plant"))]
    assert not launcher.uses_ros2
