# SPDX-License-Identifier: Apache-2.0
"""The layers keep apart: the core knows no ROS, the controllers know no truth."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tactile_hand_ros"
SOURCES = sorted((ROOT / PACKAGE).rglob("*.py"))
TESTS = sorted((ROOT / "test").rglob("*.py"))
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.is_file())

# Who may import whom; data flows core <- ros <- bag <- analysis, nodes <- orchestrator <- cli.
LAYERS = {
    "core": {"core"},
    "ros": {"core", "ros"},
    "bag": {"core", "ros", "bag"},
    "analysis": {"core", "ros", "bag", "analysis"},
    "nodes": {"core", "ros", "bag", "nodes"},
    "orchestrator": {"core", "ros", "bag", "analysis", "orchestrator"},
    "bench": {"core", "ros", "bag", "analysis", "bench"},
}
CLOCKS = {"time", "datetime"}
# Only these may see what a real hand could not measure; composed starts them with the others.
SEEING = {"__init__", "plant", "tactile_sensor", "recorder", "composed"}
BLIND = sorted(path for path in (ROOT / PACKAGE / "nodes").glob("*.py") if path.stem not in SEEING)
# The object, as the simulation knows it; scenario and closed_loop join it with the controllers.
TRUTH = {"plant", "solid", "truth", "scenario", "closed_loop"}


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
    """Return the layer of a dotted name of this package, empty for the package itself."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else ""


GRAPH = {module_name(path): imports(path) for path in SOURCES}


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


@pytest.mark.parametrize("path", SOURCES, ids=label)
def test_layer_imports_only_what_lies_below(path: Path) -> None:
    own = layer(module_name(path))
    used = {layer(name) for name in imports(path) if name.startswith(f"{PACKAGE}.")}
    used = {name for name in used if name in LAYERS or name == "cli"}
    assert used <= LAYERS.get(own, {*LAYERS, "cli"})


@pytest.mark.parametrize("path", sorted((ROOT / PACKAGE / "core").rglob("*.py")), ids=label)
def test_core_knows_neither_ros_nor_a_clock(path: Path) -> None:
    top = {name.split(".")[0] for name in imports(path)}
    ros = {name for name in top if name.startswith("rcl") or name.endswith(("_msgs", "_srvs"))}
    assert not ros | (top & {"builtin_interfaces", "ament_index_python"}) | (top & CLOCKS)


@pytest.mark.parametrize("path", BLIND, ids=label)
def test_controllers_do_not_see_the_truth(path: Path) -> None:
    text = path.read_text().lower().replace("_", " ")
    assert "ground truth" not in text and "groundtruth" not in text
    loaded = reachable(module_name(path))
    seen = {name for name in loaded if name.startswith(f"{PACKAGE}.core.")}
    assert not {name for name in seen if TRUTH & set(name.split("."))}


def test_the_three_blind_nodes_are_there() -> None:
    names = {path.stem for path in BLIND}
    assert {"force_optimizer", "manipulation_controller", "slip_regulator"} <= names


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
