# SPDX-License-Identifier: Apache-2.0
"""Finding the configuration directory, and the prefix that the package is installed in."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tactile_hand_ros.config import paths
from tactile_hand_ros.config.paths import own_prefixes, use_own_prefix
from tactile_hand_ros.errors import ConfigurationError

INDEX = Path("share", "ament_index", "resource_index")


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pretend that the package is installed in a place without any configuration."""
    module = tmp_path / "site" / "tactile_hand_ros" / "config" / "paths.py"
    monkeypatch.setattr(paths, "__file__", str(module))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.delenv("TACTILE_HAND_CONFIG", raising=False)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "empty"))
    return tmp_path


def make_share(prefix: Path) -> Path:
    """Create an installed configuration directory below a prefix."""
    directory = prefix / "share" / "tactile_hand_ros" / "config"
    directory.mkdir(parents=True)
    return directory


def test_environment_comes_first(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_share(Path(sys.prefix))
    monkeypatch.setenv("TACTILE_HAND_CONFIG", str(elsewhere))
    assert paths.config_directory() == elsewhere.resolve()


def test_source_tree_before_installations(elsewhere: Path) -> None:
    make_share(Path(sys.prefix))
    (elsewhere / "site" / "config").mkdir(parents=True)
    (elsewhere / "site" / "package.xml").touch()
    assert paths.config_directory() == (elsewhere / "site" / "config").resolve()


def test_first_ament_prefix_wins(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_share(Path(sys.prefix))
    overlay = make_share(elsewhere / "overlay")
    make_share(elsewhere / "underlay")
    prefixes = f"{elsewhere / 'empty'}:{elsewhere / 'overlay'}:{elsewhere / 'underlay'}"
    monkeypatch.setenv("AMENT_PREFIX_PATH", prefixes)
    assert paths.config_directory() == overlay.resolve()


def test_nowhere_names_the_places(elsewhere: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"empty.*prefix.*TACTILE_HAND_CONFIG"):
        paths.config_directory()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pretend that the package is in one prefix and the interpreter in another."""
    for name in ("mine", "python"):
        (tmp_path / name / INDEX / "packages").mkdir(parents=True)
    (tmp_path / "mine" / INDEX / "packages" / "tactile_hand_ros").touch()
    module = tmp_path / "mine" / "lib" / "site" / "tactile_hand_ros" / "config" / "paths.py"
    monkeypatch.setattr(paths, "__file__", str(module))
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
    listing = [str(installed / "other"), str(installed / "workspace")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(listing))
    assert listed() == listing
