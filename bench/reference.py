# SPDX-License-Identifier: Apache-2.0
"""Hashes of what every shipped scenario gives in-process: a change that is only tidying keeps them.

``python -m bench.reference write FILE`` before a change and ``compare FILE`` after it, on the same
machine and with the same libraries: another processor may round differently.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.scenario.scenario import load_scenario

Hashes = dict[str, str]


def hashes(record: Record) -> Hashes:
    """Return a short hash of each array of a record."""
    arrays = {f.name: getattr(record, f.name) for f in fields(record) if f.metadata}
    return {name: hashlib.sha256(a.tobytes()).hexdigest()[:16] for name, a in arrays.items()}


def differences(before: Hashes, after: Hashes) -> list[str]:
    """Return the arrays that are not the same to the bit, or exist only once."""
    return sorted(name for name in before | after if before.get(name) != after.get(name))


def main(arguments: Sequence[str]) -> int:
    """Write or compare; return 1 if something differs."""
    mode, file, *chosen = arguments
    found = {}
    for name in chosen or scenario_names():
        print(f"{name} ...", flush=True)
        found[name] = hashes(ClosedLoop(load_scenario(name)).run())
    if mode == "write":
        Path(file).write_text(json.dumps(found, indent=1) + "\n")
        return 0
    before = json.loads(Path(file).read_text())
    different = {name: differences(before.get(name, {}), after) for name, after in found.items()}
    for name, arrays in different.items():
        print(f"{name}: {'differs in ' + ', '.join(arrays) if arrays else 'same to the bit'}")
    return int(any(different.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
