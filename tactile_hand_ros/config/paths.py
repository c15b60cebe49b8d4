# SPDX-License-Identifier: Apache-2.0
"""Where the configuration files are, from a source tree as well as from an installation."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError

ENVIRONMENT = "TACTILE_HAND_CONFIG"
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
