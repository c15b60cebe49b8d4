# SPDX-License-Identifier: Apache-2.0
"""The command behind `make mutate`: which mutants do the tests not notice?"""

from __future__ import annotations

import argparse
import collections
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml
from mutation.mutants import Mutant, in_changed_functions, mutants_of
from mutation.trial import KILLED, Trial, folder_of, run_trials

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).parent / "equivalent.yaml"
"""The survivors that no test can notice, each with its reason."""


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make mutate ARGS=...", description=__doc__)
    add = parser.add_argument
    add("--package", action="append", default=[], help="a folder or file, such as control/slip")
    add("--since", default="main", help="only functions that differ from this commit")
    add("--all", action="store_true", help="every function, not only the changed ones")
    add("--sample", type=int, help="at most so many mutants, chosen at random")
    add("--seed", type=int, default=0, help="which sample")
    add("--jobs", type=int, default=os.cpu_count(), help="processes")
    add("--budget", type=float, default=20.0, help="seconds of tests for a mutant")
    return parser.parse_args()


def main() -> int:
    """Try the chosen mutants, print the survivors and the score of each folder.

    Returns:
        0 if every mutant was noticed or is listed as equivalent, 1 if not, 2 if nothing was tried.
    """
    args = _arguments()
    try:
        chosen = _chosen(args)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"mutate: {error}", file=sys.stderr)
        return 2
    if not chosen:
        print(f"mutate: no function differs from {args.since} (--all: every function)")
        return 2
    known = yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8"))
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)

    def on_trial(trial: Trial) -> None:
        verdict = trial.verdict
        if verdict != KILLED:
            source = (ROOT / trial.mutant.path).read_text(encoding="utf-8")
            if trial.mutant.key(source) in known:
                verdict = "equivalent"
            else:
                place = f"{trial.mutant.path}:{trial.mutant.line} {trial.mutant.function}"
                print(f"{place}: {verdict}\n{trial.mutant.diff(source)}", flush=True)
        counts[folder_of(trial.mutant.path)][verdict] += 1

    print(f"{len(chosen)} mutants, {args.jobs} processes", flush=True)
    with tempfile.TemporaryDirectory(prefix="mutate-") as scratch:
        run_trials(chosen, ROOT, Path(scratch), args.jobs, args.budget, on_trial)
    for folder, verdicts in sorted(counts.items()):
        print(folder or "top", ", ".join(f"{n} {verdict}" for verdict, n in verdicts.items()))
    return int(any(set(verdicts) - {KILLED, "equivalent"} for verdicts in counts.values()))


def _chosen(args: argparse.Namespace) -> list[Mutant]:
    """Return the mutants to try."""
    found = [each for path in _files(args.package) for each in mutants_of(path, ROOT)]
    if not args.all:
        found = in_changed_functions(found, ROOT, args.since)
    if args.sample is None or args.sample >= len(found):
        return found
    return random.Random(args.seed).sample(found, args.sample)


def _files(packages: list[str]) -> list[Path]:
    """Return the files of the named folders or files; by default all."""
    base = ROOT / "tactile_hand_ros"
    found = set()
    for name in packages or ["."]:
        path = base / name
        if not path.exists():
            raise FileNotFoundError(f"{name}: no such folder or file below tactile_hand_ros/")
        found.update(path.rglob("*.py") if path.is_dir() else [path])
    return sorted(found)


if __name__ == "__main__":
    sys.exit(main())
