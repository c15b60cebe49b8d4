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

from mutation.mutants import Mutant, in_changed_functions, mutants_of
from mutation.scores import Score, equivalents, keep, package_of, scores
from mutation.trial import KILLED, Trial, run_trials
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make mutate ARGS=...", description=__doc__)
    add = parser.add_argument
    add("--package", action="append", default=[], help="a folder or file, such as control/slip")
    add("--since", default="main", help="only functions that differ from this commit")
    add("--all", action="store_true", help="every function, not only the changed ones")
    add("--sample", type=int, help="at most so many mutants of each package, chosen at random")
    add("--seed", type=int, default=0, help="which sample")
    add("--jobs", type=int, default=os.cpu_count(), help="processes")
    add("--budget", type=float, default=20.0, help="seconds of tests for a mutant")
    add("--keep", action="store_true", help="write the scores to studies/mutation/scores.yaml")
    return parser.parse_args()


def main() -> int:
    """Try the chosen mutants, print the survivors and the scores.

    Returns:
        0 if every mutant was noticed or is listed as equivalent, 1 if not, 2 if nothing was tried.
    """
    args, console = _arguments(), Console()
    try:
        chosen, total = _chosen(args)
    except (OSError, subprocess.CalledProcessError) as error:
        console.print(f"mutate: {error}", style="red", markup=False)
        return 2
    if not chosen:
        console.print("mutate: no function differs from", args.since, "(--all: every function)")
        return 2
    with tempfile.TemporaryDirectory(prefix="mutate-") as scratch:
        trials = _try(chosen, args, Path(scratch), console)
    keys = {trial: _key(trial) for trial in trials}
    found = scores(trials, keys, total)
    _print_scores(found, console)
    if args.keep:
        keep(found, args.seed, args.sample)
    return int(any(score.killed < score.tried for score in found.values()))


def _chosen(args: argparse.Namespace) -> tuple[list[Mutant], dict[str, int]]:
    """Return the mutants to try, and how many each package has."""
    everywhere = [each for path in _files(args.package) for each in mutants_of(path, ROOT)]
    total = collections.Counter(package_of(each.path) for each in everywhere)
    if not args.all:
        everywhere = in_changed_functions(everywhere, ROOT, args.since)
    if args.sample is None:
        return everywhere, dict(total)
    by_package = collections.defaultdict(list)
    for each in everywhere:
        by_package[package_of(each.path)].append(each)
    sampled = []
    for name, each_of in sorted(by_package.items()):
        order = random.Random(f"{args.seed} {name}")
        sampled += order.sample(each_of, min(args.sample, len(each_of)))
    return sampled, dict(total)


def _files(packages: list[str]) -> list[Path]:
    """Return the files of the named packages, folders or files; by default all with a score."""
    base = ROOT / "tactile_hand_ros"
    owners = {path: package_of(str(path.relative_to(ROOT))) for path in sorted(base.rglob("*.py"))}
    if not packages:
        return [path for path, owner in owners.items() if owner]
    found = []
    for name in packages:
        inside = [path for path, owner in owners.items() if owner == name]
        inside = inside or [p for p in owners if p == base / name or base / name in p.parents]
        if not inside:
            raise FileNotFoundError(f"{name}: no such folder or file below tactile_hand_ros/")
        found += inside
    return sorted(set(found))


def _try(
    chosen: list[Mutant], args: argparse.Namespace, scratch: Path, console: Console
) -> list[Trial]:
    console.print(f"{len(chosen)} mutants, {args.jobs} processes")
    counts: collections.Counter[str] = collections.Counter()

    known = equivalents()

    def on_trial(trial: Trial) -> None:
        counts[trial.verdict] += 1
        if trial.verdict != KILLED and _key(trial) not in known:
            _print_survivor(trial, console)
        done = sum(counts.values())
        if done % 20 == 0 or done == len(chosen):
            told = ", ".join(f"{number} {verdict}" for verdict, number in sorted(counts.items()))
            console.print(f"{done}/{len(chosen)}: {told}", highlight=False)

    return run_trials(chosen, ROOT, scratch, args.jobs, args.budget, on_trial)


def _source(trial: Trial) -> str:
    return (ROOT / trial.mutant.path).read_text(encoding="utf-8")


def _key(trial: Trial) -> str:
    return "" if trial.verdict == KILLED else trial.mutant.key(_source(trial))


def _print_survivor(trial: Trial, console: Console) -> None:
    mutant = trial.mutant
    place = f"{mutant.path}:{mutant.line} {mutant.function}: {trial.verdict}"
    console.print(place, style="yellow", markup=False, highlight=False)
    console.print(mutant.diff(_source(trial)), markup=False, highlight=False, soft_wrap=True)


def _print_scores(found: dict[str, Score], console: Console) -> None:
    table = Table("package", "noticed", "tried", "score", "equivalent", "mutants")
    for name, score in sorted(found.items()):
        share = f"{100.0 * score.share:.1f} %"
        cells = (score.killed, score.tried, share, score.equivalent, score.of)
        table.add_row(name, *(str(cell) for cell in cells))
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
