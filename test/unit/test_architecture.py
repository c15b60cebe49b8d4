# SPDX-License-Identifier: Apache-2.0
"""The layers are separate: control has no ROS and no simulation, recordings need no rclpy."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tactile_hand_ros"
SOURCES = sorted((ROOT / PACKAGE).rglob("*.py"))
OTHERS = [path for top in ("test", "bench", "studies") for path in (ROOT / top).rglob("*.py")]
SCRIPTS = [path for path in (ROOT / "scripts").iterdir() if path.is_file()]

# A layer imports from itself and from the tiers above it in this list: data flows down.
TIERS = (
    ("", "names", "errors", "cdr", "extras", "files", "command_line", "config"),
    ("compiled",),
    ("rotations", "cholesky"),
    ("hand",),
    ("control",),
    ("own_law",),
    ("simulation",),
    ("scenario",),
    ("closed_loop",),
    ("ros", "bag"),
    ("nodes", "run", "report"),
    ("verify", "steering", "cockpit"),
    ("orchestrator",),
    ("sweep",),
    ("front_door",),
    ("reproduce",),
    ("cli",),
)
TIER = {name: tier for tier, names in enumerate(TIERS) for name in names}
# The code of a real hand: joints and touch in, torques out. No simulation, no ROS, no clock.
BLIND = {"hand", "control"}
PLAIN = BLIND | {"rotations", "cholesky", "errors", "names", "config", "simulation", "closed_loop"}
ACTING = ("slip_regulator", "force_optimizer", "manipulation_controller")
BLIND_NODES = tuple(f"{PACKAGE}.nodes.{name}" for name in ACTING)


def label(path: Path) -> str:
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
    """Return the imports of a file; of a module taken from a folder, the module only."""
    found = imports(path)
    taken = {name.rpartition(".")[0] for name in found & MODULES}
    names = {name.rpartition(".")[0] for name in found - MODULES}
    return {name for name in found if name not in taken - names}


GRAPH = {module_name(path): modules_used(path) for path in SOURCES}
GRAPH[PACKAGE] = set()  # the front door loads its names on first use only


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


def test_a_layer_imports_only_what_lies_below():
    wrong = []
    for name, used in GRAPH.items():
        for other in used & set(GRAPH):
            if layer(other) != layer(name) and TIER[layer(other)] > TIER[layer(name)]:
                wrong.append(f"{name} imports {other}")
    assert wrong == []


def test_no_module_imports_itself_by_way_of_others():
    for start in GRAPH:
        assert not {name for name in GRAPH[start] if name.split(".")[0] in ("bench", "studies")}
        direct = {name for name in GRAPH[start] if name in GRAPH and name != start}
        assert not any(start in reachable(name) for name in direct), start


def test_plain_code_knows_neither_ros_nor_a_clock():
    foreign = re.compile(r"(rcl\w*|\w+_(msgs|srvs|interfaces)|ament_index_python|time|datetime)\b")
    wrong = {
        name: ros
        for name, used in GRAPH.items()
        if layer(name) in PLAIN and (ros := sorted(filter(foreign.match, used)))
    }
    assert wrong == {}


def test_recordings_are_read_without_rclpy():
    """Bags are analyzed on machines without ROS."""
    for name in GRAPH:
        if layer(name) in {"bag", "run", "verify", "report"}:
            loaded = {used for module in reachable(name) for used in GRAPH[module]}
            assert not {used for used in loaded if used.split(".")[0] == "rclpy"}, name


def test_controllers_do_not_see_the_ground_truth():
    for name in GRAPH:
        if layer(name) in BLIND or name.startswith(BLIND_NODES):
            seen = {layer(module) for module in reachable(name)}
            assert not seen & {"simulation", "scenario", "closed_loop"}, name
            text = (ROOT / name.replace(".", "/")).with_suffix(".py")
            words = text.read_text().lower().replace("_", " ") if text.exists() else ""
            assert "ground truth" not in words, name
    assert all(name in "".join(GRAPH) for name in BLIND_NODES)


FORBIDDEN = re.compile(
    r"TO"
    r"DO|FIX"
    r"ME|X"
    r"XX"
    r"|\btime\.sleep\(|pytest\.mark\.(skip|xfail)|\bimportorskip\("
    r"""|["']/(home|root|work)/"""
)


def test_files_have_a_license_and_neither_leftovers_nor_skips_nor_paths_of_a_machine():
    wrong = []
    for path in sorted([*SOURCES, *OTHERS, *SCRIPTS]):
        text = path.read_text()
        licensed = "# SPDX-License-Identifier: Apache-2.0" in text.splitlines()[:2]
        wrong += [] if licensed else [label(path)]
        wrong += [f"{label(path)}: {found[0]}" for found in FORBIDDEN.finditer(text)]
    assert wrong == []
