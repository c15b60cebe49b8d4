# SPDX-License-Identifier: Apache-2.0
"""The prefix that this package is installed in, for commands that no setup file has prepared."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

_INDEX = Path("share", "ament_index", "resource_index")
_MARK = _INDEX / "packages" / "tactile_hand_ros"


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
