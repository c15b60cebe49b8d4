# SPDX-License-Identifier: Apache-2.0
"""The command behind `make mutate`: list the mutants that no test kills."""

from __future__ import annotations

import argparse
import collections
import os
import random
import sys
import tempfile
from pathlib import Path

import yaml

from studies.mutation.mutants import Mutant, mutants_of
from studies.mutation.trial import KILLED, folder_of, run_trials

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).parent / "equivalent.yaml"
"""The survivors that no test can kill, each with its reason."""


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make mutate ARGS=...", description=__doc__)
    add = parser.add_argument
    add("packages", nargs="+", help="folders or files, such as control/slip")
    add("--sample", type=int, help="maximum number of mutants, chosen at random")
    add("--seed", type=int, default=0, help="seed of the sample")
    add("--jobs", type=int, default=os.cpu_count(), help="processes")
    add("--budget", type=float, default=20.0, help="time limit for the tests of a mutant [s]")
    return parser.parse_args()


def main() -> int:
    """Test the chosen mutants, print the survivors and the score of each folder.

    Returns:
        0 if every mutant is killed or listed as equivalent, 1 if not, 2 if none was tested.
    """
    args = _arguments()
    try:
        found = [each for path in _files(args.packages) for each in mutants_of(path, ROOT)]
    except OSError as error:
        print(f"mutate: {error}", file=sys.stderr)
        return 2
    reasons = yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8"))
    known = {key for keys in reasons.values() for key in keys}
    if len(found) > (args.sample or len(found)):
        found = random.Random(args.seed).sample(found, args.sample)
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)

    def on_trial(mutant: Mutant, verdict: str) -> None:
        if verdict != KILLED and mutant.key in known:
            verdict = "equivalent"
        elif verdict != KILLED:
            print(f"{verdict}, line {mutant.line}: {mutant.key}", flush=True)
        counts[folder_of(mutant.path)][verdict] += 1

    print(f"{len(found)} mutants, {args.jobs} processes", flush=True)
    with tempfile.TemporaryDirectory(prefix="mutate-") as scratch:
        run_trials(found, ROOT, Path(scratch), args.jobs, args.budget, on_trial)
    for folder, verdicts in sorted(counts.items()):
        print(folder or "top", ", ".join(f"{n} {verdict}" for verdict, n in verdicts.items()))
    return int(any(set(verdicts) - {KILLED, "equivalent"} for verdicts in counts.values()))


def _files(packages: list[str]) -> list[Path]:
    """Return the files of the named folders or files."""
    found = set[Path]()
    for name in packages:
        path = ROOT / "tactile_hand_ros" / name
        if not path.exists():
            raise FileNotFoundError(f"{name}: no such folder or file below tactile_hand_ros/")
        found.update(path.rglob("*.py") if path.is_dir() else [path])
    return sorted(found)


if __name__ == "__main__":
    sys.exit(main())
