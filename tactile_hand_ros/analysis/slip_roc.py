# SPDX-License-Identifier: Apache-2.0
"""Detection against false alarms: forces recorded once, the detector alone replayed over them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.analysis import slip_study, tables
from tactile_hand_ros.analysis.experiments import _interrupts_held_back
from tactile_hand_ros.analysis.extras import optional
from tactile_hand_ros.analysis.metrics import json_ready
from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.errors import CollinearContactsError
from tactile_hand_ros.core.record import Record
from tactile_hand_ros.core.scenario import Scenario, load_scenario
from tactile_hand_ros.core.slip_detector import Grip, SlipDetector, SlipDetectorConfig
from tactile_hand_ros.core.squeeze import split

Array = NDArray[np.float64]

THRESHOLDS = (2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0, 30.0, 45.0)
SLIPS = 120
"""Cases of the study that are recorded; about half of them slip."""
SECONDS = 60.0
"""Simulated time of the manipulation in which nothing slips."""
NOISES = (0.003, 0.01, 0.03)  # N
IN_TIME = 0.01  # s
_AGO = 4  # ticks in which the regulator looks for changes of its own squeeze
_WAY = ((-0.1, 0.2, 0.4), (0.0, 0.0434, 0.4098))  # the paper's goal and back
_REST = 5.0  # s at each


@dataclass(frozen=True)
class Trace:
    """What the detectors of a run were given, and what was true.

    Attributes:
        step: Time between ticks, s.
        forces: Measured forces in contact frames, shape (n, k, 3), N; NaN where nothing touches.
        axes: Direction of the squeeze at each contact, shape (n, k, 3).
        own_change: How much the hand itself bent its squeeze, shape (n,), N.
        sliding: True sliding speeds, shape (n, k), m/s.
    """

    step: float
    forces: Array
    axes: Array
    own_change: Array
    sliding: Array

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.forces) * self.step


@dataclass(frozen=True)
class Point:
    """The detector at one threshold and noise.

    Attributes:
        noise: Standard deviation of each force component, N.
        threshold: Evidence from which it tells slip.
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


def paper_scenario(seconds: float, noise: float = 0.0) -> Scenario:
    """Return the paper's manipulation, there and back again, felt by a skin at 1 kHz.

    Args:
        seconds: Simulated time.
        noise: Standard deviation of each force component, N.
    """
    targets = [
        {"time": _REST * i, "position": list(_WAY[i % 2])}
        for i in range(math.ceil(seconds / _REST))
    ]
    changes = {
        "duration": seconds,
        "targets": targets,
        "plant.rate": 1000.0,
        "tactile_sensor.rate": 1000.0,
        "tactile_sensor.force_noise": noise,
        "tactile_sensor.vibration": {"gain": 10.0},
    }
    return load_scenario("paper", changes)


def slip_scenario(case: slip_study.Case) -> Scenario:
    """Return a case of the study without noise and delay, at 1 kHz."""
    return slip_study.scenario_of(
        case, tactile_sensor__force_noise=0.0, tactile_sensor__latency=0.0, tactile_sensor__rate=1e3
    )


def record_trace(scenario: Scenario) -> Trace:
    """Run a scenario and keep what its detectors saw."""
    return trace_of(ClosedLoop(scenario).run(), scenario)


def trace_of(record: Record, scenario: Scenario) -> Trace:
    """Return what the detectors of a run were given."""
    follows = scenario.slip_regulator.mode != "user"
    axes = np.zeros_like(record.forces)
    axes[:, :, 1] = 1.0
    forces = record.forces.copy()
    for i in range(len(record)):
        contacts = Contacts.from_poses(record.contact_positions[i], record.contact_quaternions[i])
        if follows and contacts.touching.all():
            axes[i] = _axes(contacts, record.forces[i], axes[i])
        forces[i, ~contacts.touching] = np.nan
    bends = np.zeros(len(record))
    bends[2:] = np.abs(np.diff(record.grasp_force, 2))
    own = [float(bends[max(0, i - _AGO) : i].max(initial=0.0)) for i in range(len(record))]
    step = 1.0 / scenario.plant.rate
    return Trace(step, forces, axes, np.array(own), record.true_sliding)


def _axes(contacts: Contacts, forces: Array, otherwise: Array) -> Array:
    try:
        return split(contacts, forces).squeeze
    except CollinearContactsError:
        return otherwise


def replay(
    trace: Trace, config: SlipDetectorConfig, noise: float = 0.0, seed: int = 0
) -> NDArray[np.int_]:
    """Return what detectors say of a trace, `Grip` of each contact, shape (n, k).

    Args:
        trace: Recorded forces.
        config: Parameters of the detectors.
        noise: Standard deviation of the noise that is added to each component, N.
        seed: Of the noise.
    """
    white = np.random.default_rng(seed).standard_normal(trace.forces.shape)
    forces = (trace.forces + noise * white).tolist()
    axes, own = trace.axes.tolist(), trace.own_change.tolist()
    n, k = trace.forces.shape[:2]
    states = np.zeros((n, k), dtype=int)
    for j in range(k):
        detector = SlipDetector(config)
        for i in range(n):
            force = forces[i][j]
            known = tuple(force) if math.isfinite(sum(force)) else None
            states[i, j] = detector.step(known, axes[i][j], own[i], trace.step if i else 0.0)
    return states


def alarms(states: NDArray[np.int_]) -> int:
    """Count alarms that begin, over all contacts."""
    slips = states == Grip.SLIP
    return int((slips[1:] & ~slips[:-1]).sum() + slips[0].sum())


def delay(trace: Trace, states: NDArray[np.int_]) -> float:
    """Return the time from the first sliding to an alarm of that contact, in s.

    NaN where nothing slid, infinite where no alarm came.
    """
    if math.isnan(_onset(trace)):
        return math.nan
    slides, onset = trace.sliding > slip_study.SLIDING, int(_onset(trace))
    told = (states[onset:, slides[onset]] == Grip.SLIP).any(axis=1)
    return float(told.argmax()) * trace.step if told.any() else math.inf


def _onset(trace: Trace) -> float:
    """Return the first tick with sliding since the event, NaN if there is none."""
    first = round(slip_study.EVENT_TIME / trace.step)
    slides = (trace.sliding[first:] > slip_study.SLIDING).any(axis=1)
    return float(first + slides.argmax()) if slides.any() else math.nan


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
        delay=slip_study.estimate(known).median,
    )


def scenarios(slips: int, seconds: float, seed: int) -> list[Scenario]:
    """Return what is recorded: the paper's manipulation, then cases of the study.

    Args:
        slips: Number of cases.
        seconds: Simulated time of the manipulation.
        seed: Of the cases.
    """
    cases = slip_study.sample_cases(slips, seed)
    return [paper_scenario(seconds), *(slip_scenario(case) for case in cases)]


def parallel(function: Any, tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """Call a function on all cores and yield the results in the order of the tasks.

    Raises:
        MissingLibraryError: If joblib is not installed.
    """
    joblib = optional("joblib", "Replaying the detector on several cores")
    work = joblib.Parallel(n_jobs=jobs, return_as="generator")
    with _interrupts_held_back():
        results = work(joblib.delayed(function)(*task) for task in tasks)
    yield from results


def run_roc(
    slips: int = SLIPS,
    seconds: float = SECONDS,
    seed: int = 0,
    jobs: int = -1,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Point]:
    """Record and replay; return a point for each noise and threshold.

    Args:
        slips: Number of cases of the study.
        seconds: Simulated time of the paper's manipulation.
        seed: Of the cases.
        jobs: Number of processes; -1 for one on each core.
        progress: Called whenever a run or a replay is done.
    """
    traces = []
    for trace in parallel(record_trace, [(s,) for s in scenarios(slips, seconds, seed)], jobs):
        traces.append(trace)
        progress("recorded")
    slid = [t for t in traces[1:] if not math.isnan(_onset(t))]
    points: list[Point] = []
    tasks = [(traces[:1], slid, noise, h) for noise in NOISES for h in THRESHOLDS]
    for result in parallel(point, tasks, jobs):
        points.append(result)
        progress(f"threshold {result.threshold:g}")
    return points


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


COLUMNS = ("noise", "threshold", "false alarms", "per minute", "slips", "within 10 ms", "delay")


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
