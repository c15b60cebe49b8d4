# SPDX-License-Identifier: Apache-2.0
"""The slip study: how fast slip is found and stopped, and at what squeeze, over many short runs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studies.slip.cases import EVENTS, SlipCase, pull_of, sample_cases
from studies.slip.outcomes import HELD, Held, SlipOutcome, hold_case, run_case
from tactile_hand_ros.report import tables
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.sweep.engine import in_parallel
from tactile_hand_ros.sweep.statistics import rank, share


@dataclass(frozen=True)
class Study:
    """All runs.

    Attributes:
        seed: Of the cases.
        outcomes: Runs with an event.
        pulls: 10 N at once on 0.2 kg with mu = 0.5, under the noise and latency of some cases.
        held: Runs that nothing disturbs.
    """

    seed: int
    outcomes: list[SlipOutcome]
    pulls: list[SlipOutcome]
    held: list[Held]


def tasks_of(runs: int, seed: int) -> list[tuple[SlipCase, str]]:
    """Return all runs: those with an event, some with the same pull, and a few held for longer."""
    cases = sample_cases(runs, seed)
    long, same = (cases[:: min(runs, every)] for every in (200, 40))
    # The longest first, so that no core waits for one at the end.
    out = [(case, kind) for kind in sorted(HELD, key=lambda k: -HELD[k]) for case in long]
    out += [(pull_of(case), "pull") for case in same]
    return out + [(case, "event") for case in cases]


def _run(task: tuple[SlipCase, str]) -> SlipOutcome | Held:
    case, kind = task
    return hold_case(case, kind) if kind in HELD else run_case(case)


def run_study(runs: int, seed: int, progress: Callable[[str], None] = lambda _: None) -> Study:
    """Run the study, where `workers` says.

    Args:
        runs: Number of runs with an event.
        seed: The same seed gives the same numbers, on any number of cores.
        progress: Called whenever a run is done.
    """
    tasks = tasks_of(runs, seed)
    found: dict[str, list[Any]] = {kind: [] for kind in ("event", "pull", *HELD)}
    for (case, kind), result in zip(tasks, in_parallel(_run, tasks), strict=True):
        found[kind].append(result)
        progress(f"{kind}, run {case.index}")
    held = [result for kind in HELD for result in found[kind]]
    return Study(seed, found["event"], found["pull"], held)


@dataclass(frozen=True)
class Estimate:
    """Median and percentiles of a quantity, with the 95 % bootstrap interval of the median."""

    count: int
    median: float
    low: float
    high: float
    p90: float
    p99: float


def estimate(values: Sequence[float], seed: int = 0, resamples: int = 1000) -> Estimate:
    """Return median and percentiles; infinite values count as larger than all others.

    Args:
        values: The sample; NaN is left out.
        seed: Of the bootstrap.
        resamples: Number of bootstrap samples.
    """
    known = np.sort([v for v in values if not math.isnan(v)])
    if not len(known):
        return Estimate(0, *[math.nan] * 5)
    picks = np.random.default_rng(seed).integers(0, len(known), (resamples, len(known)))
    medians = rank(np.sort(known[picks], axis=1).T, 0.5)
    low, high = rank(np.sort(medians), 0.025), rank(np.sort(medians), 0.975)
    middle = [rank(known, share) for share in (0.5, 0.9, 0.99)]
    return Estimate(len(known), float(middle[0]), float(low), float(high), *map(float, middle[1:]))


COLUMNS = ("", "runs", "median", "95 % interval", "90 %", "99 %", "goal")
SHARE_COLUMNS = ("", "runs", "share", "95 % interval")


def rows(study: Study) -> list[list[str]]:
    """Return the results as text, columns as in `COLUMNS`."""
    slipped = [o for o in study.outcomes if not math.isnan(o.onset)]
    fast = [o for o in slipped if o.case.rate == 1000.0]
    prompt = [o for o in fast if o.case.latency <= 0.002]
    out = []
    for name, some in (("", slipped), (", 1 kHz", fast), (", 1 kHz, latency < 2 ms", prompt)):
        out.append(_row(f"detection{name}", [1e3 * o.detection for o in some], "ms", "< 10 ms"))
    for name, some in (("", slipped), (", 1 kHz", fast), (", 1 kHz, latency < 2 ms", prompt)):
        out.append(_row(f"reaction{name}", [1e3 * o.reaction for o in some], "ms", "< 20 ms"))
    for event in EVENTS:
        some = [o for o in slipped if o.case.event == event and o.survivable]
        out.append(_row(f"slip distance, {event}", [1e3 * o.slip for o in some], "mm", ""))
    pulls = [1e3 * o.slip for o in study.pulls]
    out.append(_row("slip distance, 10 N on 0.2 kg, mu 0.5", pulls, "mm", "< 1 mm"))
    out.append(_row("largest squeeze / least", [o.peak for o in slipped if o.survivable], "", ""))
    for kind in HELD:
        ratios = [h.ratio for h in study.held if h.kind == kind]
        out.append(_row(f"steady squeeze / least, mu {kind}", ratios, "", "< 1.4"))
    return out


def _row(name: str, values: Sequence[float], unit: str, goal: str) -> list[str]:
    e = estimate(values)
    interval = f"{_text(e.low)} to {_text(e.high)}"
    numbers = [f"{_text(e.median)} {unit}".rstrip(), interval, _text(e.p90), _text(e.p99)]
    return [name, str(e.count), *numbers, goal]


def _text(value: float) -> str:
    return "never" if math.isinf(value) else tables.number(float(f"{value:.3g}"))


def share_rows(study: Study) -> list[list[str]]:
    """Return what happened how often, columns as in `SHARE_COLUMNS`."""
    slipped = [o for o in study.outcomes if not math.isnan(o.onset)]
    survivable = [o for o in study.outcomes if o.survivable]
    flags = {
        "slipped": [not math.isnan(o.onset) for o in study.outcomes],
        "alarm within 10 ms of slipping": [o.detection <= 0.01 for o in slipped],
        "alarm at all after slipping": [math.isfinite(o.detection) for o in slipped],
        "squeeze rose within 20 ms of slipping": [o.reaction <= 0.02 for o in slipped],
        "no alarm without slip before the event": [o.false_alarms == 0 for o in study.outcomes],
        "slid before the event": [o.early_slip > 1e-5 for o in study.outcomes],
        "a grasp inside the crush limit can survive": [o.survivable for o in study.outcomes],
        "survivable: lost": [o.lost for o in survivable],
        "survivable: at rest in the end": [o.caught for o in survivable],
        "survivable: slid less than 1 mm": [o.slip < 1e-3 for o in survivable],
    }
    return [
        [name, str(len(values)), *_share_texts(*share(values))] for name, values in flags.items()
    ]


def _share_texts(value: float, low: float, high: float) -> tuple[str, str]:
    return f"{100 * value:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %"


def write(study: Study, folder: Path) -> list[Path]:
    """Write all runs as JSON and the tables as Markdown; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    report, data = folder / "study_slip.md", folder / "study_slip.json"
    text = [
        f"# Slip study: {len(study.outcomes)} runs, seed {study.seed}\n",
        tables.markdown(COLUMNS, rows(study)),
        tables.markdown(SHARE_COLUMNS, share_rows(study)),
    ]
    report.write_text("\n".join(text), encoding="utf-8")
    data.write_text(json.dumps(json_ready(asdict(study)), indent=1) + "\n", encoding="utf-8")
    return [report, data]
