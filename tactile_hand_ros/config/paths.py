# SPDX-License-Identifier: Apache-2.0
"""Where the configuration files and this package are: a source tree, a workspace, an install."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError

ENVIRONMENT = "TACTILE_HAND_CONFIG"
_INDEX = Path("share", "ament_index", "resource_index")
_MARK = _INDEX / "packages" / "tactile_hand_ros"
_SHARE = Path("share") / "tactile_hand_ros" / "config"


def config_directory() -> Path:
    """Find the directory with ``hands/`` and ``scenarios/``.

    The first that exists of: the environment variable ``TACTILE_HAND_CONFIG`` (which must exist
    when set), ``config/`` beside the package (a source tree), ``share/tactile_hand_ros/config`` of
    every prefix in ``AMENT_PREFIX_PATH`` (a ROS workspace), the same below ``sys.prefix`` (a
    virtual environment).

    Returns:
        Absolute path of the directory.

    Raises:
        ConfigurationError: No such directory.
    """
    chosen = os.environ.get(ENVIRONMENT)
    if chosen:
        return _chosen_directory(Path(chosen))
    candidates = list(_candidates())
    for candidate in candidates:
        if candidate.is_dir():
            return candidate.resolve()
    searched = ", ".join(str(candidate) for candidate in candidates)
    raise ConfigurationError(
        f"No configuration directory in {searched}: install the package or set {ENVIRONMENT}."
    )


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in (config_directory() / "scenarios").glob("*.yaml"))


def _chosen_directory(path: Path) -> Path:
    """Insist on what the user named; a silent fall-back would run with other values."""
    if not path.is_dir():
        raise ConfigurationError(
            f"{ENVIRONMENT} is '{path}', which is not a directory: name one with hands/ and"
            " scenarios/, or unset it."
        )
    return path.resolve()


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
