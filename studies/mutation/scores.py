# SPDX-License-Identifier: Apache-2.0
"""Scores by package, and the survivors that no test can notice."""

from __future__ import annotations

import datetime
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import yaml
from mutation.trial import KILLED, Trial

HERE = Path(__file__).parent
EQUIVALENT = HERE / "equivalent.yaml"
SCORES = HERE / "scores.yaml"

# Longest prefix first. What is left out is for people to look at: commands, figures, studies.
PACKAGES = (
    *("control/slip", "control/optimizer", "control", "hand", "simulation", "closed_loop"),
    *("ros/ticks", "ros", "nodes", "bag", "run", "verify", "report", "orchestrator", "steering"),
    *("config",),
)
_FIGURES = ("report/figures.py", "report/scene.py", "report/style.py")


def package_of(path: str) -> str:
    """Return the package that a file counts for; `top` for modules beside the packages."""
    inside = path.removeprefix("tactile_hand_ros/")
    if inside in _FIGURES:
        return ""
    if "/" not in inside:
        return "top"
    found = [each for each in PACKAGES if inside.startswith(f"{each}/")]
    return found[0] if found else ""


@dataclass
class Score:
    """Of one package.

    Attributes:
        tried: Mutants that were tried, without the equivalent ones.
        killed: Those that a test noticed.
        equivalent: Survivors that are listed with their reason.
        of: Mutants that the package has.
    """

    tried: int = 0
    killed: int = 0
    equivalent: int = 0
    of: int = 0

    @property
    def share(self) -> float:
        """Share of the tried mutants that a test noticed."""
        return self.killed / self.tried if self.tried else float("nan")


def equivalents() -> dict[str, str]:
    """Return the reason by the key of each mutant that is judged equivalent."""
    if not EQUIVALENT.is_file():
        return {}
    return dict(yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or {})


def scores(trials: list[Trial], keys: dict[Trial, str], total: dict[str, int]) -> dict[str, Score]:
    """Count by package."""
    known = equivalents()
    found: dict[str, Score] = defaultdict(Score)
    for trial in trials:
        name = package_of(trial.mutant.path)
        score = found[name]
        score.of = total[name]
        if trial.verdict == KILLED:
            score.tried += 1
            score.killed += 1
        elif keys[trial] in known:
            score.equivalent += 1
        else:
            score.tried += 1
    return dict(found)


def keep(found: dict[str, Score], seed: int, sample: int | None) -> None:
    """Write the scores of the packages that were tried; those of others stay.

    Args:
        found: The scores.
        seed: Which sample.
        sample: Its size, None if everything was tried.
    """
    kept = yaml.safe_load(SCORES.read_text(encoding="utf-8")) if SCORES.is_file() else {}
    for name, score in found.items():
        kept[name] = {
            "score_percent": round(100.0 * score.share, 1),
            "killed": score.killed,
            "tried": score.tried,
            "equivalent": score.equivalent,
            "mutants": score.of,
            "sample": sample or "all",
            "seed": seed,
            "date": datetime.date.today().isoformat(),
        }
    text = '# Written by `make mutate ARGS="--all --sample N --seed S --keep"`.\n'
    SCORES.write_text(text + yaml.safe_dump(dict(sorted(kept.items())), sort_keys=False))
