# SPDX-License-Identifier: Apache-2.0
"""package.xml, setup.py, the requirements and the imports agree."""

import ast
import sys
import xml.etree.ElementTree as ElementTree
from importlib.metadata import metadata, requires, version
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import tactile_hand_ros

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
EXEC_DEPENDS = [str(element.text) for element in MANIFEST.findall("exec_depend")]
# Libraries whose rosdep key or module differs from the name on the Python index.
KEY_TO_DISTRIBUTION = {"pinocchio": "pin", "python3-yaml": "pyyaml"}
# Coal comes with Pinocchio.
MODULE_TO_DISTRIBUTION = {"coal": "pin", "pinocchio": "pin", "yaml": "pyyaml"}


def requirements(name: str) -> dict[str, Requirement]:
    """Read a requirements file by distribution name, without those for other Python versions."""
    lines = (ROOT / "requirements" / name).read_text().splitlines()
    wanted = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return {
        canonicalize_name(each.name): each
        for each in wanted
        if each.marker is None or each.marker.evaluate()
    }


STUDIES = requirements("studies.txt")


def declared() -> list[Requirement]:
    """Return install_requires and all extras, as installed, for this Python."""
    found = [Requirement(text) for text in requires("tactile_hand_ros") or []]
    extras = metadata("tactile_hand_ros").get_all("Provides-Extra") or []
    return [
        each
        for each in found
        if not each.marker or any(each.marker.evaluate({"extra": extra}) for extra in extras)
    ]


def test_versions_agree():
    stated = MANIFEST.findtext("version")
    assert version("tactile_hand_ros") == stated
    assert tactile_hand_ros.__version__ == stated
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == stated


def test_the_hosted_workflow_runs_make_test_and_nothing_else():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    [job] = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make test"]


def test_everything_required_reaches_a_ros_workspace():
    keys = ((key, key.removeprefix("python3-")) for key in EXEC_DEPENDS)
    from_rosdep = {KEY_TO_DISTRIBUTION.get(key, name) for key, name in keys}
    from_pip = set(requirements("jazzy.txt"))
    needed = {canonicalize_name(each.name) for each in declared()}
    tested_with = set(requirements("dev.txt") | STUDIES)
    assert needed - from_rosdep - from_pip - tested_with == set()


def test_pins_lie_in_the_declared_ranges():
    pinned = requirements("run.txt") | requirements("dev.txt") | STUDIES
    for each in declared():
        pin = next(iter(pinned[canonicalize_name(each.name)].specifier)).version
        assert each.specifier.contains(pin), f"{each} is pinned to {pin}"


def locked(name: str) -> dict[str, list[Requirement]]:
    """Read a locked file by distribution name; a version may depend on Python's."""
    text = (ROOT / "requirements/locked" / name).read_text().replace(" \\\n", " ")
    found: dict[str, list[Requirement]] = {}
    for line in text.splitlines():
        if line and not line.startswith(("#", " ")):
            stated, *hashes = line.split(" --hash=")
            assert hashes, f"{stated} has no hash"
            each = Requirement(stated)
            found.setdefault(canonicalize_name(each.name), []).append(each)
    return found


@pytest.mark.parametrize("name", "ros run dev studies docs hands".split())
def test_pins_are_locked_with_their_hashes(name):
    name = f"{name}.txt"
    files = [path.name for path in (ROOT / "requirements/locked").iterdir()]
    everything = {key: each for file in files for key, each in locked(file).items()}
    for key, pin in requirements(name).items():
        assert any(each.specifier == pin.specifier for each in everything[key]), (
            f"{pin} is not in requirements/locked: run `make lock`"
        )


def test_jazzy_pins_are_those_of_run():
    run = requirements("run.txt")
    for name, each in requirements("jazzy.txt").items():
        if name != "typer":
            assert each.specifier == run[name].specifier


def test_a_ros_workspace_gets_a_typer_that_can_read_the_commands():
    """Ubuntu 24.04 has 0.9; `float | None` needs 0.12.4. The lower bound is the declared one."""
    [declared_typer] = [each for each in declared() if each.name == "typer"]
    wanted = requirements("jazzy.txt")["typer"].specifier
    for too_old in ("0.9.0", "0.12.3"):
        assert not wanted.contains(too_old) and not declared_typer.specifier.contains(too_old)
    for fine in ("0.12.4", "0.29.1"):
        assert wanted.contains(fine) and declared_typer.specifier.contains(fine)


def imported_modules() -> set[str]:
    """Collect the external top-level modules that the package imports at load time or later."""
    found: set[str] = set()
    for path in (ROOT / "tactile_hand_ros").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).split(".")[0])
    return found - sys.stdlib_module_names - {"tactile_hand_ros"}


# tf2_msgs is optional and never required; llvmlite comes with Numba.
@pytest.mark.parametrize("module", sorted(imported_modules() - {"tf2_msgs", "llvmlite"}))
def test_import_is_declared(module):
    distribution = canonicalize_name(MODULE_TO_DISTRIBUTION.get(module, module))
    names = {canonicalize_name(each.name) for each in declared()}
    assert module in EXEC_DEPENDS or distribution in names, f"declare {module} in package.xml"
