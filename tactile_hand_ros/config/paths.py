# SPDX-License-Identifier: Apache-2.0
"""Where the configuration files and this package are: a source tree, a workspace, an install."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError

_INDEX = Path("share", "ament_index", "resource_index")
_MARK = _INDEX / "packages" / "tactile_hand_ros"
_SHARE = Path("share") / "tactile_hand_ros" / "config"


def config_directory() -> Path:
    """Find the directory with ``hands/`` and ``scenarios/``.

    The first that exists of: ``config/`` beside the package (a source tree),
    ``share/tactile_hand_ros/config`` of every prefix in ``AMENT_PREFIX_PATH`` (a ROS workspace),
    the same below ``sys.prefix`` (a virtual environment).

    Returns:
        Absolute path of the directory.

    Raises:
        ConfigurationError: No such directory.
    """
    candidates = list(_candidates())
    for candidate in candidates:
        if candidate.is_dir():
            return candidate.resolve()
    searched = ", ".join(str(candidate) for candidate in candidates)
    raise ConfigurationError(f"No configuration directory in {searched}: install the package.")


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in (config_directory() / "scenarios").glob("*.yaml"))


def _candidates() -> Iterator[Path]:
    """Yield the places to look at, best first."""
    tree = Path(__file__).resolve().parents[2]
    # Some unrelated config/ may lie beside an installed package: package.xml marks our own tree.
    if (tree / "package.xml").is_file():
        yield tree / "config"
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / _SHARE
    yield Path(sys.prefix) / _SHARE


def use_own_prefix() -> None:
    """Put the prefixes of this package and of this interpreter on AMENT_PREFIX_PATH.

    Executables and message definitions are looked up there. Where the package is listed already,
    as in a sourced workspace, nothing changes.
    """
    listed = [entry for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    if any((Path(entry) / _MARK).exists() for entry in listed):
        return
    found = [str(prefix) for prefix in own_prefixes() if str(prefix) not in listed]
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([*listed, *dict.fromkeys(found)])


def own_prefixes() -> Iterator[Path]:
    """Yield the prefix of this package and that of this interpreter, where they have an index."""
    for folder in Path(__file__).resolve().parents:
        if (folder / _MARK).exists():
            yield folder
            break
    if (Path(sys.prefix) / _INDEX).is_dir():
        yield Path(sys.prefix)
