# SPDX-License-Identifier: Apache-2.0
"""Commands find the index of ament without a setup file, and leave a sourced workspace alone."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tactile_hand_ros.config import prefix as prefix_module
from tactile_hand_ros.config.prefix import own_prefixes, use_own_prefix

INDEX = Path("share", "ament_index", "resource_index")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pretend that the package is in one prefix and the interpreter in another."""
    for name in ("mine", "python"):
        (tmp_path / name / INDEX / "packages").mkdir(parents=True)
    (tmp_path / "mine" / INDEX / "packages" / "tactile_hand_ros").touch()
    module = tmp_path / "mine" / "lib" / "site" / "tactile_hand_ros" / "config" / "prefix.py"
    monkeypatch.setattr(prefix_module, "__file__", str(module))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    return tmp_path.resolve()


def listed() -> list[str]:
    use_own_prefix()
    return os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)


def test_package_and_interpreter_are_added_once(installed: Path) -> None:
    expected = [str(installed / "mine"), str(installed / "python")]
    assert [str(path) for path in own_prefixes()] == expected
    assert listed() == expected
    assert listed() == expected


def test_what_is_listed_stays_and_comes_first(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, python = str(installed / "other"), str(installed / "python")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", other, python]))
    assert listed() == [other, python, str(installed / "mine")]


def test_a_workspace_that_has_the_package_stays_as_it_is(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = installed / "workspace" / INDEX / "packages" / "tactile_hand_ros"
    mark.parent.mkdir(parents=True)
    mark.touch()
    paths = [str(installed / "other"), str(installed / "workspace")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(paths))
    assert listed() == paths


def test_one_prefix_for_both_is_listed_once(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(installed / "mine"))
    assert listed() == [str(installed / "mine")]


def test_a_place_without_an_index_is_not_listed(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (installed / "mine" / INDEX / "packages" / "tactile_hand_ros").unlink()
    monkeypatch.setattr(sys, "prefix", str(installed / "nowhere"))
    assert list(own_prefixes()) == [] and listed() == [""]
