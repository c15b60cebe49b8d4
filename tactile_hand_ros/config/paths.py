# SPDX-License-Identifier: Apache-2.0
"""Locations of the configuration files and of this package, for any kind of installation."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError

_INDEX = Path("share", "ament_index", "resource_index")
_MARK = _INDEX / "packages" / "tactile_hand_ros"
_SHARE = Path("share") / "tactile_hand_ros" / "config"


def config_directory() -> Path:
    """Return the absolute path of the directory with ``hands/`` and ``scenarios/``.

    It is the first that exists of: ``config/`` next to the package (a source tree),
    ``share/tactile_hand_ros/config`` of every prefix in ``AMENT_PREFIX_PATH`` (a ROS workspace),
    the same below ``sys.prefix`` (a virtual environment).
    """
    tree = Path(__file__).resolve().parents[2]
    # An unrelated config/ may lie next to an installed package: package.xml marks our own tree.
    candidates = [tree / "config"] if (tree / "package.xml").is_file() else []
    candidates += [Path(prefix) / _SHARE for prefix in (*_listed_prefixes(), sys.prefix)]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate.resolve()
    searched = ", ".join(str(candidate) for candidate in candidates)
    raise ConfigurationError(f"No configuration directory in {searched}: install the package.")


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in (config_directory() / "scenarios").glob("*.yaml"))


def _listed_prefixes() -> list[str]:
    return [entry for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]


def use_own_prefix() -> None:
    """Put the prefixes of this package and of this interpreter on AMENT_PREFIX_PATH.

    Executables and message definitions are looked up there. A package that is already listed, as in
    a sourced workspace, is not added again.
    """
    listed = _listed_prefixes()
    if any((Path(entry) / _MARK).exists() for entry in listed):
        return
    found = [folder for folder in Path(__file__).resolve().parents if (folder / _MARK).exists()][:1]
    if (Path(sys.prefix) / _INDEX).is_dir():
        found.append(Path(sys.prefix))
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join(dict.fromkeys([*listed, *map(str, found)]))
