# SPDX-License-Identifier: Apache-2.0
"""The installations: pip into a virtual environment, colcon into a workspace; and the sdist."""

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from tactile_hand_ros.ros import processes as executables

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tactile_hand_ros"
EXECUTABLES = """
cockpit composed controllers driver_output force_optimizer foxglove_bridge
manipulation_controller orchestrator plant recorder slip_regulator tactile_sensor viewer
""".split()
# What an installation is made of, and nothing that a developer may have lying about.
SOURCES = ("config", "launch", "resource", "scripts", PACKAGE)
FILES = ("package.xml", "setup.py", "setup.cfg", "pyproject.toml", "LICENSE", "NOTICE", "README.md")
# The ROS wheels re-execute an interpreter once and say so here; no other installation may see it.
LEAKING = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH")


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    """Run a command in an environment without ROS, insist on success and return its output."""
    inherited = executables.child_environment()
    environment = {name: value for name, value in inherited.items() if name not in LEAKING}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment | variables,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def copy_sources(target: Path) -> Path:
    """Copy what an installation is made of to a new folder and return it."""
    ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
    for folder in SOURCES:
        shutil.copytree(ROOT / folder, target / folder, ignore=ignored)
    for file in FILES:
        shutil.copy(ROOT / file, target / file)
    return target


def installed_config(share: Path) -> list[Path]:
    """List the configuration files of an installation, relative to its config directory."""
    config = share / "config"
    return sorted(path.relative_to(config) for path in config.rglob("*") if path.is_file())


class TestPip:
    """The environment that runs these tests, as `make test` has built it."""

    def test_ament_finds_the_package_with_its_config_and_launch_file(self):
        prefix = Path(get_package_prefix(PACKAGE))
        share = Path(get_package_share_directory(PACKAGE))
        assert share == prefix / "share" / PACKAGE
        assert (share / "package.xml").read_bytes() == (ROOT / "package.xml").read_bytes()
        assert installed_config(share) == installed_config(ROOT)
        assert (share / "launch" / "tactile_hand.launch.py").is_file()

    def test_executables_are_those_of_the_contract(self):
        found = [path.name for path in executables.executable_directory().iterdir()]
        assert sorted(found) == EXECUTABLES

    def test_config_is_found_without_ament(self, tmp_path):
        code = f"from {PACKAGE}.config.paths import config_directory; print(config_directory())"
        found = Path(run(sys.executable, "-c", code, cwd=tmp_path).strip())
        assert (found / "hands").is_dir()
        assert ROOT not in found.parents or Path(sys.prefix) in found.parents

    def test_command_line_answers(self, tmp_path):
        assert "reproduce" in run("tactile-hand", "--help", cwd=tmp_path, COLUMNS="200")

    def test_child_process_finds_this_interpreter(self):
        path = executables.child_environment()["PATH"]
        assert Path(str(shutil.which("python3", path=path))).parent == Path(sys.prefix) / "bin"


def test_a_source_distribution_has_all_files(tmp_path):
    """`python -m build` makes the wheel from it."""
    tree = copy_sources(tmp_path / "tree")
    wanted = {str(path.relative_to(tree)) for path in tree.rglob("*") if path.is_file()}
    run(sys.executable, "setup.py", "--quiet", "sdist", "--dist-dir", tmp_path, cwd=tree)
    [archive] = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        assert wanted <= {name.partition("/")[2] for name in opened.getnames()}


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a clean copy of the tree with colcon."""
    workspace = tmp_path_factory.mktemp("workspace")
    copy_sources(workspace / "src" / PACKAGE)
    run("colcon", "build", cwd=workspace)
    return workspace


class TestColcon:
    """The same tree in a ROS workspace."""

    def test_it_is_a_ros_package_with_executables_config_and_manifest(self, workspace):
        listed = run("colcon", "list", cwd=workspace).split()
        assert listed == [PACKAGE, f"src/{PACKAGE}", "(ros.ament_python)"]
        folder = workspace / "install" / PACKAGE / "lib" / PACKAGE
        runnable = sorted(path.name for path in folder.iterdir() if os.access(path, os.X_OK))
        assert runnable == sorted([*EXECUTABLES, "tactile-hand"])
        share = workspace / "install" / PACKAGE / "share" / PACKAGE
        assert (share / "package.xml").is_file()
        assert installed_config(share) == installed_config(ROOT)

    def test_sourced_workspace_is_found_by_ament(self, workspace):
        code = (
            "from ament_index_python.packages import get_package_prefix as prefix;"
            f"from {PACKAGE}.config.paths import config_directory;"
            f"import {PACKAGE};"
            f"print(prefix('{PACKAGE}'), config_directory(), {PACKAGE}.__file__, sep='\\n')"
        )
        command = f"install/{PACKAGE}/lib/{PACKAGE}/tactile-hand"
        words = f'. install/setup.sh && python3 -c "{code}" && {command} --version'
        prefix, config, module, version = run("sh", "-c", words, cwd=workspace).splitlines()
        assert version.startswith("tactile-hand ")
        install = workspace / "install" / PACKAGE
        assert Path(prefix) == install
        assert Path(config) == install / "share" / PACKAGE / "config"
        assert install in Path(module).parents
