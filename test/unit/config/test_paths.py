# SPDX-License-Identifier: Apache-2.0
"""Finding the configuration directory and the installation prefix of the package."""

import os
import sys
from pathlib import Path

import pytest

from tactile_hand_ros.config import paths
from tactile_hand_ros.config.paths import config_directory, use_own_prefix
from tactile_hand_ros.errors import ConfigurationError

PACKAGES = Path("share", "ament_index", "resource_index", "packages")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pretend that package and interpreter have prefixes of their own, without configuration."""
    for name in ("mine", "python"):
        (tmp_path / name / PACKAGES).mkdir(parents=True)
    (tmp_path / "mine" / PACKAGES / "tactile_hand_ros").touch()
    module = tmp_path / "mine" / "site" / "tactile_hand_ros" / "config" / "paths.py"
    monkeypatch.setattr(paths, "__file__", str(module))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    return tmp_path.resolve()


def make_share(prefix: Path) -> Path:
    """Create an installed configuration directory below a prefix."""
    directory = prefix / "share" / "tactile_hand_ros" / "config"
    directory.mkdir(parents=True)
    return directory


def test_configuration_is_looked_for_in_the_tree_then_in_the_prefixes(installed, monkeypatch):
    with pytest.raises(ConfigurationError, match="python.*install the package"):
        config_directory()
    expected = make_share(installed / "python")
    assert config_directory() == expected
    overlay, _ = (make_share(installed / name) for name in ("overlay", "underlay"))
    prefixes = [str(installed / name) for name in ("empty", "overlay", "underlay")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(prefixes))
    assert config_directory() == overlay
    tree = installed / "mine" / "site"
    (tree / "config").mkdir(parents=True)
    assert config_directory() == overlay  # an unrelated config/ next to an installed package
    (tree / "package.xml").touch()
    assert config_directory() == tree / "config"


def listed(monkeypatch: pytest.MonkeyPatch, *before: Path | str) -> list[str]:
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(map(str, before)))
    use_own_prefix()
    use_own_prefix()
    return os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)


def test_package_and_interpreter_are_listed_once_after_what_is_there(installed, monkeypatch):
    mine, python, other = (str(installed / name) for name in ("mine", "python", "other"))
    assert listed(monkeypatch) == [mine, python]
    assert listed(monkeypatch, "", other, python) == [other, python, mine]
    workspace = installed / "workspace"
    (workspace / PACKAGES).mkdir(parents=True)
    (workspace / PACKAGES / "tactile_hand_ros").touch()
    assert listed(monkeypatch, other, workspace) == [other, str(workspace)]
