# SPDX-License-Identifier: Apache-2.0
"""Find and start this package's executables as ``ros2 run`` does, also where ``ros2`` is missing.

``python -m tactile_hand_ros.ros.executables NAME [ARGUMENT ...]`` becomes that executable.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from tactile_hand_ros.errors import TactileHandError

PACKAGE = "tactile_hand_ros"


class ExecutableError(TactileHandError):
    """An executable of this package that cannot be found."""


def executable_directory() -> Path:
    """Return ``<prefix>/lib/tactile_hand_ros``, the only place where ``ros2 run`` looks.

    Raises:
        ExecutableError: The ament index does not know the package.
    """
    try:
        prefix = get_package_prefix(PACKAGE)
    except (PackageNotFoundError, LookupError, OSError) as error:  # OSError: there is no index
        searched = os.environ.get("AMENT_PREFIX_PATH", "")
        raise ExecutableError(
            f"The ament index at AMENT_PREFIX_PATH='{searched}' does not know {PACKAGE}:"
            " build it (make setup, or colcon build) and source or set the prefix."
        ) from error
    return Path(prefix) / "lib" / PACKAGE


def executable_names() -> list[str]:
    """Return the names that ``ros2 run tactile_hand_ros`` offers, sorted."""
    return sorted(path.name for path in executable_directory().iterdir() if _runs(path))


def executable_path(name: str) -> Path:
    """Return the file that ``ros2 run tactile_hand_ros <name>`` would start.

    Args:
        name: Name of the executable, such as ``plant``.

    Raises:
        ExecutableError: No such executable.
    """
    path = executable_directory() / name
    if not name or Path(name).name != name or not _runs(path):
        known = ", ".join(executable_names())
        raise ExecutableError(f"There is no executable '{name}': choose one of {known}.")
    return path


def child_environment() -> dict[str, str]:
    """Return the environment for a child process, with this interpreter first on PATH.

    The executables begin with ``#!/usr/bin/env python3``: without an activated virtual environment
    they would find another Python.
    """
    environment = dict(os.environ)
    inherited = environment.get("PATH", os.defpath)
    environment["PATH"] = os.pathsep.join([os.path.join(sys.prefix, "bin"), inherited])
    return environment


def _runs(path: Path) -> bool:
    """Return whether a path is a file with its run bit set."""
    return path.is_file() and os.access(path, os.X_OK)


def main(arguments: Sequence[str] | None = None) -> int:
    """Become the named executable; return only when that is impossible."""
    name, *rest = list(sys.argv[1:] if arguments is None else arguments) or [""]
    try:
        path = executable_path(name)
    except ExecutableError as error:
        print(error, file=sys.stderr)
        return 2
    os.execve(path, [str(path), *rest], child_environment())


if __name__ == "__main__":
    sys.exit(main())
