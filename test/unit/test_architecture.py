# SPDX-License-Identifier: Apache-2.0
"""The layers keep apart: control knows no ROS and no simulation, recordings need no rclpy."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tactile_hand_ros"
SOURCES = sorted((ROOT / PACKAGE).rglob("*.py"))
TESTS = sorted((ROOT / "test").rglob("*.py"))
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.is_file())

# What may be imported from everywhere.
BASE = {
    "",
    "cholesky",
    "command_line",
    "command_options",
    "config",
    "errors",
    "extras",
    "files",
    "jit",
    "names",
    "rotations",
}
RUNS = {"hand", "control", "closed_loop", "bag", "run"}
# Who may import whom, besides itself. Data flows down this list.
LAYERS = {
    "errors": set(),
    "command_line": {"errors"},
    "command_options": set(),
    "extras": {"errors"},
    "files": set(),
    "names": set(),
    "config": {"errors"},
    "jit": {"config", "errors", "files"},
    "cholesky": {"jit"},
    "rotations": {"jit"},
    "hand": BASE,
    "control": BASE | {"hand"},
    "simulation": BASE | {"hand", "control"},
    "closed_loop": BASE | {"hand", "control", "simulation"},
    "ros": BASE | {"control"},
    "bag": BASE,
    "nodes": BASE | {"hand", "control", "simulation", "ros", "bag"},
    "run": BASE | RUNS,
    "verify": BASE | RUNS | {"ros"},
    "report": BASE | RUNS,
    "steering": BASE | {"ros"},
    "orchestrator": BASE | RUNS | {"report", "ros", "nodes"},
    "studies": BASE | RUNS | {"report", "simulation", "ros", "nodes"},
    "bench": BASE
    | RUNS
    | {"report", "verify", "simulation", "ros", "orchestrator", "studies", "nodes"},
}
CLOCKS = {"time", "datetime"}
# What a real hand runs: joints and touch in, torques out. No simulation, no ROS, no clock.
BLIND = ("hand", "control")
PLAIN = (
    "cholesky",
    "errors",
    "extras",
    "files",
    "names",
    "rotations",
    "config",
    "jit",
    "simulation",
    "closed_loop",
)
SEEING_NODES = {"plant", "tactile_sensor", "readings", "composed", "recorder", "replay", "viewer"}
BLIND_NODES = sorted(
    path
    for path in (ROOT / PACKAGE / "nodes").rglob("*.py")
    if path.relative_to(ROOT / PACKAGE / "nodes").parts[0].removesuffix(".py") not in SEEING_NODES
)
# The one file that replays a bag through real nodes.
WITH_RCLPY = {f"{PACKAGE}/verify/replay_through_nodes.py"}
CHANGING = {
    *("BagWriter", "Span", "Tally", "_Channel", "Layout", "_Messages"),
    *("Results", "RunOutcome", "ReplayProgress", "_Rejections", "Cluster", "Report", "Soak"),
}
"""Dataclasses that are not frozen."""

MOST_MODULES = 16
"""In one folder, without its __init__."""


def label(path: Path) -> str:
    """Name a file in a test's id."""
    return str(path.relative_to(ROOT))


def module_name(path: Path) -> str:
    """Return the dotted name of a file of the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Return the dotted names that a file imports, `from a import b` as both a and a.b."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{label(path)}:{node.lineno}: import by the full name"
            found.add(str(node.module))
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def layer(name: str) -> str:
    """Return the layer of a dotted name: a folder or file of the package, empty for itself."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else ""


MODULES = {module_name(path) for path in SOURCES}


def modules_used(path: Path) -> set[str]:
    """Return what a file imports, without the folder where it takes a module out of one."""
    found = imports(path)
    taken = {name.rpartition(".")[0] for name in found & MODULES}
    names = {name.rpartition(".")[0] for name in found - MODULES}
    return {name for name in found if name not in taken - names}


GRAPH = {module_name(path): modules_used(path) for path in SOURCES}
GRAPH[PACKAGE] = set()  # the front door loads what it names on first use only


def reachable(start: str) -> set[str]:
    """Return all modules of this package that importing `start` loads."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in GRAPH and name not in found:
            found.add(name)
            waiting.extend(GRAPH[name])
    return found


def own_imports(path: Path) -> set[str]:
    """Return the modules of this package that a file imports, without those of its own layer."""
    mine = layer(module_name(path))
    used = {name for name in imports(path) if name == PACKAGE or name.startswith(f"{PACKAGE}.")}
    return {name for name in used & set(GRAPH) if layer(name) != mine}


@pytest.mark.parametrize("path", SOURCES, ids=label)
def test_a_layer_imports_only_what_lies_below(path: Path) -> None:
    allowed = LAYERS.get(layer(module_name(path)))
    if allowed is not None:  # cli and the front door may import everything
        assert {layer(name) for name in own_imports(path)} - {""} <= allowed


def test_every_folder_has_its_rule() -> None:
    folders = {layer(module_name(path)) for path in SOURCES}
    assert folders == {*LAYERS, "cli", ""}


def test_no_module_imports_itself_by_way_of_others() -> None:
    for start in GRAPH:
        direct = {name for name in GRAPH[start] if name in GRAPH and name != start}
        assert not any(start in reachable(name) for name in direct), start


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if layer(module_name(p)) in {*BLIND, *PLAIN}], ids=label
)
def test_plain_code_knows_neither_ros_nor_a_clock(path: Path) -> None:
    top = {name.split(".")[0] for name in imports(path)}
    ros = {name for name in top if name.startswith("rcl") or name.endswith(("_msgs", "_srvs"))}
    assert not ros | (top & {"builtin_interfaces", "ament_index_python"}) | (top & CLOCKS)


@pytest.mark.parametrize(
    "path",
    [p for p in SOURCES if layer(module_name(p)) in {"bag", "run", "verify", "report"}],
    ids=label,
)
def test_recordings_are_read_without_rclpy(path: Path) -> None:
    """Bags are analysed on machines without ROS."""
    if label(path) not in WITH_RCLPY:
        loaded = {name for module in reachable(module_name(path)) for name in GRAPH[module]}
        assert not {name for name in loaded if name.split(".")[0] == "rclpy"}


@pytest.mark.parametrize("layer_name", BLIND)
def test_the_blind_layers_reach_nothing_of_the_simulation(layer_name: str) -> None:
    for module in [name for name in GRAPH if layer(name) == layer_name]:
        reached = {layer(name) for name in reachable(module)}
        assert not reached & {"simulation", "closed_loop", "ros", "nodes"}, module


@pytest.mark.parametrize("path", BLIND_NODES, ids=label)
def test_controllers_do_not_see_the_truth(path: Path) -> None:
    text = path.read_text().lower().replace("_", " ")
    assert "ground truth" not in text and "groundtruth" not in text
    assert "simulation" not in {layer(name) for name in reachable(module_name(path))}


def test_the_three_blind_nodes_are_there() -> None:
    names = {path.parent.name for path in BLIND_NODES}
    assert {"force_optimizer", "manipulation_controller", "slip_regulator"} <= names


def test_only_those_who_simulate_import_the_simulation() -> None:
    users = {
        name.removeprefix(f"{PACKAGE}.")
        for name, used in GRAPH.items()
        if any(layer(other) == "simulation" for other in used)
    }
    allowed = ("simulation", "closed_loop", "studies", "bench", "nodes.plant")
    allowed += ("nodes.tactile_sensor", "nodes.readings", "nodes.viewer")
    assert {name for name in users if not name.startswith(allowed)} == set()


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in SOURCES}), ids=lambda path: label(path)
)
def test_a_folder_can_be_taken_in_at_a_glance(folder: Path) -> None:
    modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
    assert len(modules) <= MOST_MODULES


def test_results_are_immutable() -> None:
    """All dataclasses are frozen but for those that are filled step by step."""
    declared = re.compile(r"^ *@dataclass(\(frozen=True.*\))?\n *class (\w+)", re.MULTILINE)
    found = [each for path in SOURCES for each in declared.findall(path.read_text())]
    assert {name for frozen, name in found if not frozen} == CHANGING
    assert len(found) > len(CHANGING)


@pytest.mark.parametrize("path", [*SOURCES, *TESTS, *SCRIPTS], ids=label)
def test_file_begins_with_its_licence(path: Path) -> None:
    lines = path.read_text().splitlines()
    first = lines[1] if lines[0].startswith("#!") else lines[0]
    assert first == "# SPDX-License-Identifier: Apache-2.0"


@pytest.mark.parametrize("path", [*SOURCES, *TESTS, *SCRIPTS], ids=label)
def test_nothing_is_left_for_later(path: Path) -> None:
    text = path.read_text()
    for mark in ("TO" + "DO", "FIX" + "ME", "X" * 3):
        assert mark not in text


@pytest.mark.parametrize("path", [*SOURCES, *TESTS, *SCRIPTS], ids=label)
def test_nothing_sleeps_or_is_skipped(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute):
            assert node.attr not in {"skip", "skipif", "xfail", "importorskip"}, node.lineno
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            assert (owner, node.attr) != ("time", "sleep"), node.lineno


@pytest.mark.parametrize("path", [*SOURCES, *TESTS, *SCRIPTS], ids=label)
def test_no_path_of_some_machine(path: Path) -> None:
    text = path.read_text()
    for folder in ("home", "root", "work"):
        assert f'"/{folder}/' not in text and f"'/{folder}/" not in text
