# SPDX-License-Identifier: Apache-2.0
"""The Makefile in unusual places, and the output of the set-up while pip works."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a prepared tree with a command that prints its arguments."""
    tree = tmp_path / "it's a tree"
    environment, locked = tree / ".venv", tree / "requirements" / "locked"
    sources = "setup.py setup.cfg package.xml pyproject.toml"
    for folder in (environment / "bin", locked):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "Makefile", tree)
    for file in (*map(tree.joinpath, sources.split()), locked / "run.txt", locked / "studies.txt"):
        file.touch()
    (environment / ".created").write_text(f"{environment}\n")
    (environment / ".run").touch()
    (environment / ".sources").write_text(f"{sources} \n")
    (environment / ".package").touch()
    command = environment / "bin" / "tactile-hand"
    command.write_text("#!/bin/sh\nprintf '<%s>' \"$@\"\n")
    command.chmod(0o755)
    return tree


def make(tree: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run make as from a shell, even if the tests themselves run below make."""
    own = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    return subprocess.run(
        ["make", *words], cwd=tree, env=own, capture_output=True, text=True, timeout=60
    )


@pytest.mark.parametrize("name", ["paper", "it's.yaml", "my runs/a b.yaml", 'say "x".yaml'])
def test_any_name_of_a_scenario_arrives_whole(tree, name):
    done = make(tree, "run", f"SCENARIO={name}", "ARGS=--duration 3")
    assert done.stdout == f"<run><{name}><--duration><3>", done.stderr


def test_a_python_that_is_named_later_makes_the_environment_again(tree):
    (tree / ".venv" / ".python").write_text("python3\n")
    assert make(tree, "demo", "PYTHON=python3").stdout == "<run><paper>"
    done = make(tree, "demo", "PYTHON=no-such-python")
    assert done.returncode == 2 and "there is no 'no-such-python'" in done.stderr


@pytest.mark.parametrize(
    ("words", "command"), [(["bench"], "bench --help"), (["study", "NAME=slip"], "slip --help")]
)
def test_tools_run_beside_the_package(tree, words, command):
    done = make(tree, "--dry-run", *words, "ARGS=--help")
    assert command in done.stdout, done.stderr
