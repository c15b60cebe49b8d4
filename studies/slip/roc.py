# SPDX-License-Identifier: Apache-2.0
"""Detection against false alarms: the detector alone, replayed over recorded forces."""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from studies.slip.cases import SlipCase, sample_cases, scenario_of
from studies.slip.study import estimate
from studies.slip.trace import Trace, alarms, delay, onset, record_trace, replay
from tactile_hand_ros.control.slip.detector import SlipDetectorConfig
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.style import FAINT, PAGE, finger_color, label_panel, look, new_figure
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, plain
from tactile_hand_ros.sweep.engine import in_parallel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS = ("o", "s", "^")
THRESHOLDS = (2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0, 28.0, 45.0)
SLIPS = 120
"""Cases of the study that are recorded; about half of them slip."""
SECONDS = 60.0
"""Simulated time of the manipulation in which nothing slips."""
NOISES = (0.003, 0.01, 0.03)  # N
IN_TIME = 0.01  # s
_WAY = ((-0.1, 0.2, 0.4), (0.0, 0.0434, 0.4098))  # the paper's goal and back
_REST = 5.0  # s at each
COLUMNS = ("noise", "threshold", "false alarms", "per minute", "slips", "within 10 ms", "delay")


@dataclass(frozen=True)
class Point:
    """The detector at one threshold and noise.

    Attributes:
        noise: Standard deviation of each force component, N.
        threshold: Evidence from which it reports slip.
        false_alarms: Alarms of all contacts while nothing slid.
        minutes: Time in which nothing slid.
        slips: Number of slips.
        in_time: Alarms of the sliding contact within 10 ms.
        delay: Median time from onset to alarm, infinite where most gave none, s.
    """

    noise: float
    threshold: float
    false_alarms: int
    minutes: float
    slips: int
    in_time: int
    delay: float

    @property
    def false_alarm_rate(self) -> float:
        """False alarms per minute."""
        return self.false_alarms / self.minutes if self.minutes > 0.0 else math.nan


def paper_scenario(seconds: float, *, noise: bool = False, seed: int = 1) -> Scenario:
    """Return the paper's manipulation, there and back again, felt by a skin at 1 kHz.

    Args:
        seconds: Simulated time.
        noise: Whether the skin is that of `gravity`, or perfect.
        seed: Of the skin.
    """
    targets = [
        {"time": _REST * i, "position": list(_WAY[i % 2])}
        for i in range(math.ceil(seconds / _REST))
    ]
    skin = plain(load_scenario("gravity"))["tactile_sensor"] if noise else {"rate": 1000.0}
    changes = {
        "duration": seconds,
        "seed": seed,
        "targets": targets,
        "plant.rate": 1000.0,
        "tactile_sensor": skin,
    }
    return load_scenario("paper", changes)


def slip_scenario(case: SlipCase) -> Scenario:
    """Return a case of the study without noise and delay, at 1 kHz, and without a reserve.

    A hand with a reserve holds most of the cases, and a detector shows nothing where nothing slips.
    """
    return scenario_of(
        case,
        tactile_sensor__force_noise=0.0,
        tactile_sensor__latency=0.0,
        tactile_sensor__rate=1e3,
        slip_regulator__reflex__need__reserve__floor=0.0,
        force_optimizer__reserve__floor=0.0,
    )


def point(sticks: Sequence[Trace], slips: Sequence[Trace], noise: float, threshold: float) -> Point:
    """Replay all traces with one noise and threshold."""
    config = SlipDetectorConfig(threshold=threshold)
    count = sum(alarms(replay(t, config, noise, seed)) for seed, t in enumerate(sticks))
    delays = [delay(t, replay(t, config, noise, 1000 + i)) for i, t in enumerate(slips)]
    known = [d for d in delays if not math.isnan(d)]
    return Point(
        noise=noise,
        threshold=threshold,
        false_alarms=count,
        minutes=sum(t.seconds for t in sticks) / 60.0,
        slips=len(known),
        in_time=sum(d <= IN_TIME for d in known),
        delay=estimate(known).median,
    )


def scenarios(slips: int, seconds: float, seed: int) -> list[Scenario]:
    """Return what is recorded: the paper's manipulation, then cases of the study.

    Args:
        slips: Number of cases.
        seconds: Simulated time of the manipulation.
        seed: Of the cases.
    """
    cases = sample_cases(slips, seed)
    return [paper_scenario(seconds), *(slip_scenario(case) for case in cases)]


def run_roc(
    slips: int = SLIPS,
    seconds: float = SECONDS,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Point]:
    """Record and replay, where `workers` says; return a point for each noise and threshold.

    Args:
        slips: Number of cases of the study.
        seconds: Simulated time of the paper's manipulation.
        seed: Of the cases.
        progress: Called whenever a run or a replay is done.
    """
    traces = []
    for trace in in_parallel(record_trace, scenarios(slips, seconds, seed)):
        traces.append(trace)
        progress(f"run {len(traces)}")
    slid = [t for t in traces[1:] if not math.isnan(onset(t))]
    points = []
    replays = functools.partial(_replay, traces[:1], slid)
    for found in in_parallel(replays, itertools.product(NOISES, THRESHOLDS)):
        points.append(found)
        progress(f"replay {len(points)}")
    return points


def _replay(sticks: Sequence[Trace], slips: Sequence[Trace], at: tuple[float, float]) -> Point:
    return point(sticks, slips, *at)


def steps(slips: int) -> int:
    """Return how often `run_roc` reports progress."""
    return 1 + slips + len(NOISES) * len(THRESHOLDS)


def write(points: Sequence[Point], folder: Path) -> list[Path]:
    """Write the points as JSON and as Markdown; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    report, data = folder / "study_roc.md", folder / "study_roc.json"
    report.write_text(tables.markdown(COLUMNS, rows(points)), encoding="utf-8")
    content = json_ready([asdict(p) for p in points])
    data.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return [report, data]


def rows(points: Sequence[Point]) -> list[list[str]]:
    """Return points as text, columns as in `COLUMNS`."""
    return [
        [
            tables.number(p.noise, "N"),
            tables.number(p.threshold),
            str(p.false_alarms),
            tables.number(p.false_alarm_rate),
            str(p.slips),
            f"{100 * p.in_time / p.slips:.1f} %" if p.slips else "unknown",
            "never" if math.isinf(p.delay) else tables.number(1e3 * p.delay, "ms"),
        ]
        for p in points
    ]


def roc_figure(points: Sequence[Point]) -> Figure:
    """Draw detection within 10 ms, and the median delay, against false alarms."""
    with look():
        figure = new_figure(PAGE, 2.6)
        left, right = figure.subplots(1, 2)
        for i, noise in enumerate(sorted({p.noise for p in points})):
            some = [p for p in points if p.noise == noise]
            # None at all still leaves one in the time that was looked at; a logarithm needs more.
            x = [max(p.false_alarm_rate, 0.5 / p.minutes) for p in some]
            name, mark = f"{1e3 * noise:g} mN", _MARKS[i % 3] + "-"
            style = {"color": finger_color(i), "markersize": 3.5, "label": name}
            left.plot(x, [p.in_time / max(p.slips, 1) for p in some], mark, **style)
            right.plot([p.threshold for p in some], [1e3 * p.delay for p in some], mark, **style)
        left.set_xscale("log")
        left.set_ylim(0.0, 1.0)
        left.set_xlabel("false alarms per minute (leftmost: none)")
        left.set_ylabel("alarm within 10 ms")
        label_panel(left, "a", "receiver operating curve")
        right.axhline(10.0, color=FAINT, linewidth=0.8)
        right.set_xlabel("threshold of evidence")
        right.set_ylabel("median delay [ms]")
        right.set_ylim(bottom=0.0)
        label_panel(right, "b", "delay of detection")
        left.legend(title="force noise")
    return figure
