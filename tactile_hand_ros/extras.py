# SPDX-License-Identifier: Apache-2.0
"""Optional libraries, and the error when one is missing."""

from __future__ import annotations

import importlib
from typing import Any

from tactile_hand_ros.errors import TactileHandError


class MissingLibraryError(TactileHandError):
    """An optional library that is not installed."""


def optional(module: str, purpose: str, package: str = "") -> Any:
    """Import a module that `purpose` needs and pip installs as `package`, by default its name.

    Raises:
        MissingLibraryError: If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.split(".")[0]:
            raise
        raise MissingLibraryError(
            f"{purpose} needs the Python library {error.name}, which is not installed; run "
            f"`pip install {package or error.name}`."
        ) from None
