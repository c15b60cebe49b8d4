# SPDX-License-Identifier: Apache-2.0
"""Detection against false alarms: the detector alone, replayed over recorded forces.

The forces of a manipulation in which nothing slips, and of cases of the slip study, are recorded
once without noise. White noise is added, and the detector is replayed for several times between
false alarms that are accepted.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from studies.slip.study import EVENT_TIME, SLIDING, SlipCase, sample_cases, scenario_of
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts, in_palm
from tactile_hand_ros.control.grasp import MIN_COLLINEARITY_MARGIN
from tactile_hand_ros.control.loads import split
from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.style import PAGE, finger_color, look, new_figure
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, plain
from tactile_hand_ros.sweep.engine import in_parallel
from tactile_hand_ros.sweep.statistics import rank

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
T = TypeVar("T")

TIMES = (1.0, 10.0, 100.0, 1e3, 3600.0, 1e5, 1e7, 1e9)  # s
NOISES = (0.003, 0.01, 0.03)  # N
IN_TIME = 0.01  # s
COLUMNS = ("noise", "time between", "false alarms", "per minute", "slips", "within 10 ms", "delay")

_WAY = ((-0.1, 0.2, 0.4), (0.0, 0.0434, 0.4098))  # the paper's goal and back
_REST = 5.0  # s at each


@dataclass(frozen=True)
class Trace:
    """What the detectors of a run were given, and what was true.

    Attributes:
        step: Time between ticks, s.
        forces: Measured forces, palm axes, shape (n, k, 3), N; NaN where nothing touches.
        normals: Contact normals, palm axes, shape (n, k, 3).
        axes: Direction of the internal force at each contact, palm axes, shape (n, k, 3).
        fresh: Whether the forces are new samples, shape (n, k).
        sliding: True sliding speeds, shape (n, k), m/s.
    """

    step: float
    forces: Array
    normals: Array
    axes: Array
    fresh: NDArray[np.bool_]
    sliding: Array

    @property
    def onset(self) -> int | None:
        """The first tick with sliding since the event, None if there is none."""
        first = round(EVENT_TIME / self.step)
        slides = (self.sliding[first:] > SLIDING).any(axis=1)
        return first + int(slides.argmax()) if slides.any() else None


@dataclass(frozen=True)
class Score:
    """The detector at one noise and time between false alarms.

    Attributes:
        noise: Standard deviation of each force component, N.
        time: Accepted mean time between false alarms of a contact, s.
        false_alarms: Alarms of all contacts while nothing slid.
        minutes: Time in which nothing slid.
        slips: Number of slips.
        in_time: Alarms of the sliding contact within 10 ms.
        delay: Median time from onset to alarm, infinite where most gave none, s.
    """

    noise: float
    time: float
    false_alarms: int
    minutes: float
    slips: int
    in_time: int
    delay: float

    @property
    def false_alarm_rate(self) -> float:
        """False alarms per minute."""
        return self.false_alarms / self.minutes if self.minutes > 0.0 else math.nan


def paper_scenario(seconds: float, *, noise: bool = False) -> Scenario:
    """Return the paper's manipulation, there and back again, measured by a skin at 1 kHz.

    Args:
        seconds: Simulated time.
        noise: Whether the skin is that of `gravity`, or perfect.
    """
    targets = [
        {"time": _REST * i, "position": list(_WAY[i % 2])}
        for i in range(math.ceil(seconds / _REST))
    ]
    skin = plain(load_scenario("gravity"))["tactile_sensor"] if noise else {"rate": 1000.0}
    changes = {"duration": seconds, "targets": targets, "plant.rate": 1000.0}
    return load_scenario("paper", {**changes, "tactile_sensor": skin})


def slip_scenario(case: SlipCase) -> Scenario:
    """Return a case of the study without noise and latency, at 1 kHz, and without a reserve.

    A hand with a reserve holds most of the cases, and a detector shows nothing where nothing slips.
    """
    perfect = {
        "tactile_sensor.force_noise": 0.0,
        "tactile_sensor.latency": 0.0,
        "tactile_sensor.rate": 1e3,
        "slip_regulator.reflex.need.reserve.floor": 0.0,
        "force_optimizer.reserve.floor": 0.0,
    }
    return scenario_of(case, perfect)


def record_trace(scenario: Scenario) -> Trace:
    """Run a scenario and keep what its detectors were given."""
    return trace_of(ClosedLoop(scenario).run(), scenario)


def trace_of(record: Record, scenario: Scenario) -> Trace:
    """Return what the detectors of a run were given."""
    follows = scenario.slip_regulator.mode != "user"
    forces, normals = np.empty_like(record.forces), np.empty_like(record.forces)
    axes = np.empty_like(record.forces)
    for i in range(len(record)):
        contacts = Contacts.from_poses(record.contact_positions[i], record.contact_quaternions[i])
        forces[i] = in_palm(contacts.rotations, record.forces[i], 1.0)
        forces[i, ~contacts.touching] = np.nan
        normals[i] = axes[i] = contacts.normals
        if follows and contacts.all_touching:
            parts = split(contacts.positions, normals[i], forces[i])
            axes[i] = parts.internal if parts.margin >= MIN_COLLINEARITY_MARGIN else normals[i]
    fresh = np.ones(record.forces.shape[:2], dtype=bool)
    fresh[1:] = (record.forces[1:] != record.forces[:-1]).any(axis=2)
    return Trace(1.0 / scenario.plant.rate, forces, normals, axes, fresh, record.true_sliding)


def replay(
    trace: Trace, config: SlipDetectorConfig, noise: float = 0.0, seed: int = 0
) -> NDArray[np.int_]:
    """Return what detectors make of a trace, `ContactState` of each contact, shape (n, k).

    Args:
        trace: Recorded forces.
        config: Parameters of the detectors.
        noise: Standard deviation of the noise that is added to each component, N.
        seed: Of the noise.
    """
    white = np.random.default_rng(seed).standard_normal(trace.forces.shape)
    forces = trace.forces + noise * white
    detector = SlipDetector(config, forces.shape[1])
    states = np.zeros(forces.shape[:2], dtype=np.int64)
    for i in range(len(forces)):
        dt = trace.step if i else 0.0
        told = trace.normals[i], trace.axes[i], trace.fresh[i]
        states[i] = detector.step(forces[i], *told, dt)
    return states


def alarms(states: NDArray[np.int_]) -> int:
    """Count alarms that begin, over all contacts."""
    slips = states == ContactState.SLIP
    return int((slips[1:] & ~slips[:-1]).sum() + slips[0].sum())


def delay(trace: Trace, states: NDArray[np.int_]) -> float:
    """Return the time from the first sliding to an alarm of that contact, s; infinite if none."""
    first = trace.onset
    if first is None:
        return math.nan
    slides = trace.sliding[first] > SLIDING
    alarm = (states[first:, slides] == ContactState.SLIP).any(axis=1)
    return float(alarm.argmax()) * trace.step if alarm.any() else math.inf


def score(still: Trace, slips: Sequence[Trace], at: tuple[float, float]) -> Score:
    """Replay a trace without slip, and traces that slip, at a noise and a false alarm time."""
    noise, time = at
    config = SlipDetectorConfig(false_alarm_time=time)
    delays = sorted(delay(t, replay(t, config, noise, 1000 + i)) for i, t in enumerate(slips))
    return Score(
        noise=noise,
        time=time,
        false_alarms=alarms(replay(still, config, noise)),
        minutes=len(still.forces) * still.step / 60.0,
        slips=len(slips),
        in_time=sum(d <= IN_TIME for d in delays),
        delay=float(rank(np.array(delays), 0.5)) if delays else math.nan,
    )


def run_roc(
    slips: int = 120,
    seconds: float = 60.0,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Score]:
    """Record and replay, where `workers` says; return a score for each noise and time.

    Args:
        slips: Number of cases of the study; about half of them slip.
        seconds: Simulated time of the paper's manipulation.
        seed: Of the cases.
        progress: Called whenever a run or a replay is done.
    """
    recorded = [paper_scenario(seconds), *map(slip_scenario, sample_cases(slips, seed))]
    traces = _collected(in_parallel(record_trace, recorded), progress)
    slid = [trace for trace in traces[1:] if trace.onset is not None]
    grid = itertools.product(NOISES, TIMES)
    return _collected(in_parallel(functools.partial(score, traces[0], slid), grid), progress)


def _collected(results: Iterable[T], progress: Callable[[str], None]) -> list[T]:
    found = []
    for result in results:
        found.append(result)
        progress(str(len(found)))
    return found


def steps(slips: int) -> int:
    """Return how often `run_roc` reports progress."""
    return 1 + slips + len(NOISES) * len(TIMES)


def rows(scores: Sequence[Score]) -> list[list[str]]:
    """Return scores as text, columns as in `COLUMNS`."""
    return [
        [
            tables.number(s.noise, "N"),
            tables.number(s.time, "s"),
            str(s.false_alarms),
            tables.number(s.false_alarm_rate),
            str(s.slips),
            f"{100 * s.in_time / s.slips:.1f} %" if s.slips else "unknown",
            "never" if math.isinf(s.delay) else tables.number(1e3 * s.delay, "ms"),
        ]
        for s in scores
    ]


def figure(scores: Sequence[Score]) -> Figure:
    """Draw detection within 10 ms, and the median delay, against false alarms."""
    with look():
        made = new_figure(PAGE, 2.6)
        left, right = made.subplots(1, 2)
        for i, noise in enumerate(NOISES):
            some = [s for s in scores if s.noise == noise]
            # None at all still leaves one in the time that was looked at; a logarithm needs more.
            x = [max(s.false_alarm_rate, 0.5 / s.minutes) for s in some]
            style = {"color": finger_color(i), "markersize": 3.5, "label": f"{1e3 * noise:g} mN"}
            left.plot(x, [s.in_time / max(s.slips, 1) for s in some], "os^"[i] + "-", **style)
            delays = [1e3 * s.delay for s in some]
            right.plot([s.time for s in some], delays, "os^"[i] + "-", **style)
        left.set(xscale="log", ylim=(0.0, 1.0), ylabel="alarm within 10 ms")
        left.set_xlabel("false alarms per minute (leftmost: none)")
        left.legend(title="force noise")
        right.set(xscale="log", xlabel="accepted time between false alarms [s]")
        right.set_ylabel("median delay [ms]")
        right.set_ylim(bottom=0.0)
    return made
