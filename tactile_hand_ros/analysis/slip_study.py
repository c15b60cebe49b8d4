# SPDX-License-Identifier: Apache-2.0
"""How fast slip is found and stopped, and at what squeeze, over many short runs of a held object.

Every run starts where the hand stands once it knows the object: with the friction as the estimate
and the squeeze that this takes. After a while the surface turns slippery, or somebody pulls.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.analysis import tables
from tactile_hand_ros.analysis.experiments import _interrupts_held_back
from tactile_hand_ros.analysis.extras import optional
from tactile_hand_ros.analysis.least_squeeze import least_squeeze
from tactile_hand_ros.analysis.metrics import json_ready
from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.disturbance import external_wrench
from tactile_hand_ros.core.plant import Plant
from tactile_hand_ros.core.record import Record
from tactile_hand_ros.core.scenario import Scenario, load_scenario

Array = NDArray[np.float64]
Event = Literal["friction", "step", "ramp"]

EVENTS: tuple[Event, ...] = ("friction", "step", "ramp")
LOADS = {"friction": (1.2, 3.5), "step": (1.5, 8.0), "ramp": (1.5, 8.0)}
RATES = (250.0, 500.0, 1000.0)
CENTROID = (0.0, 0.0434, 0.4098)  # of the contacts at the start: the object is held where it is
EVENT_TIME, DURATION, RAMP = 0.12, 0.3, 0.05  # s
SLIDING = 1e-3  # m/s; slower sliding is creep of contacts that hold
RISEN = 1.02  # squeeze against that before the event, from which it counts as a reaction
LOST_SLIDE = 0.02  # m; as far as this no grasp is left
HELD = {"known": 2.0, "unknown": 6.0}  # duration of the runs that nothing disturbs, s
_INERTIA = 0.0113  # of a uniform cube of this size, per mass, m^2


@dataclass(frozen=True)
class Case:
    """What is varied from run to run.

    Attributes:
        index: Number of the run; it seeds the sensor.
        event: What happens.
        friction: mu before the event.
        mass: Mass of the object, kg.
        noise: Standard deviation of each force component, N.
        latency: Age of a tactile sample, s.
        rate: Samples per second, Hz.
        load: Least squeeze after the event against that before it.
        pull: Direction in which somebody pulls.
    """

    index: int
    event: Event
    friction: float
    mass: float
    noise: float
    latency: float
    rate: float
    load: float
    pull: tuple[float, float, float]


@dataclass(frozen=True)
class Outcome:
    """What came out of a run; times are against the true onset, NaN where there was none.

    Attributes:
        case: What was varied.
        onset: First tick with a sliding contact after the event, s.
        detection: From there to the first alarm of that contact; infinite where none came.
        reaction: From there to the squeeze that the plant acts on rising; below zero if the load
            had been foreseen, infinite if it never rose.
        slip: Largest distance that a contact slid since the event, m.
        early_slip: The same before the event.
        false_alarms: Alarms before the event while nothing slid.
        excess: Least squeeze after the event against the one that was held at it.
        survivable: Whether a grasp inside the crush limit can carry the load after the event.
        lost: Whether a contact was gone at the end, or had slid too far.
        caught: Whether nothing slid any more at the end.
        peak: Largest sum of normal forces since the event against the least after it.
    """

    case: Case
    onset: float
    detection: float
    reaction: float
    slip: float
    early_slip: float
    false_alarms: int
    excess: float
    survivable: bool
    lost: bool
    caught: bool
    peak: float


@dataclass(frozen=True)
class Held:
    """The squeeze of a grasp that nothing disturbs, in the end.

    Attributes:
        case: What was varied.
        kind: Whether the friction was known from the start.
        ratio: Sum of the true normal forces against the least that holds.
        estimate: Largest estimated friction against the true one.
        slip: Largest distance that a contact slid, m.
    """

    case: Case
    kind: str
    ratio: float
    estimate: float
    slip: float


@dataclass(frozen=True)
class Estimate:
    """Median and percentiles of a quantity, with the 95 % bootstrap interval of the median."""

    count: int
    median: float
    low: float
    high: float
    p90: float
    p99: float


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
    outcomes: list[Outcome]
    pulls: list[Outcome]
    held: list[Held]


def sample_cases(runs: int, seed: int) -> list[Case]:
    """Return cases that fill the ranges evenly, by Latin-hypercube sampling.

    Args:
        runs: Number of cases.
        seed: The same seed gives the same cases.
    """
    qmc = optional("scipy.stats.qmc", "The slip study")
    cases = []
    for i, u in enumerate(qmc.LatinHypercube(d=9, rng=np.random.default_rng(seed)).random(runs)):
        angle, tilt = 2.0 * math.pi * u[7], 0.5 * u[8]
        sideways, event = math.sin(tilt), EVENTS[int(3 * u[0])]
        cases.append(
            Case(
                index=i,
                event=event,
                friction=_between(0.2, 1.0, u[1]),
                mass=_between(0.05, 0.5, u[2]),
                noise=_between(0.002, 0.03, u[3]),
                latency=round(0.01 * u[4], 4),
                rate=RATES[int(3 * u[5])],
                load=_between(*LOADS[event], u[6]),
                pull=(
                    sideways * math.cos(angle),
                    sideways * math.sin(angle),
                    -math.cos(tilt),
                ),
            )
        )
    return cases


def _between(low: float, high: float, share: float) -> float:
    """Return a value at a share of the logarithm of a range."""
    return float(low * (high / low) ** share)


@functools.cache
def _start() -> tuple[Contacts, Array]:
    """Return the contacts and the centre of mass at the start of a run."""
    plant = Plant(load_scenario("gravity").plant)
    return plant.state.contacts, plant.state.position


def scenario_of(case: Case, **changes: Any) -> Scenario:
    """Return the scenario of a case, by default with its event.

    Args:
        case: What is varied.
        changes: Values by dotted key with two underscores for a dot, over those of the case.
    """
    base = load_scenario("gravity").slip_regulator
    contacts, position = _start()
    wrench = np.array([0.0, 0.0, -9.81 * case.mass, 0.0, 0.0, 0.0])
    least = _least(contacts, position, wrench, case.friction)
    squeeze = min(max(1.3 * least, base.minimum), base.maximum)
    values = {
        "duration": DURATION,
        "seed": case.index + 1,
        "targets": [{"time": 0.0, "position": list(CENTROID)}],
        "plant.object.mass": case.mass,
        "plant.object.inertia": [_INERTIA * case.mass] * 3,
        "plant.object.friction": case.friction,
        "tactile_sensor.force_noise": case.noise,
        "tactile_sensor.latency": case.latency,
        "tactile_sensor.rate": case.rate,
        "slip_regulator.grasp_force": squeeze,
        "slip_regulator.friction.prior": case.friction,
        **_event(case),
        **{key.replace("__", "."): value for key, value in changes.items()},
    }
    return load_scenario("gravity", values)


def _event(case: Case) -> dict[str, Any]:
    if case.event == "friction":
        change = {"start": EVENT_TIME, "friction": case.friction / case.load}
        return {"plant.friction_changes": [change]}
    force = [9.81 * case.mass * (case.load - 1.0) * x for x in case.pull]
    push = {"kind": case.event, "start": EVENT_TIME, "duration": RAMP, "force": force}
    return {"plant.disturbances": [push]}


def _least(contacts: Contacts, position: Array, wrench: Array, friction: float) -> float:
    """Return the least squeeze against a wrench on the object about its centre of mass."""
    torque = wrench[3:] + np.cross(position - contacts.centroid, wrench[:3])
    return least_squeeze(contacts, -np.concatenate([wrench[:3], torque]), friction)


def least_at(record: Record, scenario: Scenario, time: float, row: int) -> float:
    """Return the least squeeze against the true load and friction of a time.

    Args:
        record: The run.
        scenario: What was run.
        time: Time of load and friction, s.
        row: Tick of the contacts and of the object's pose.
    """
    plant = scenario.plant
    contacts = Contacts.from_poses(record.true_positions[row], record.true_quaternions[row])
    wrench = external_wrench(plant.disturbances, time)
    wrench[:3] += plant.object.mass * np.array(plant.gravity)
    friction = plant.object.friction
    for change in plant.friction_changes:
        friction = change.friction if change.start <= time else friction
    return _least(contacts, record.object_position[row], wrench, friction)


def run_case(case: Case) -> Outcome:
    """Run a case and measure it."""
    scenario = scenario_of(case)
    return measure(ClosedLoop(scenario).run(), scenario, case)


def measure(record: Record, scenario: Scenario, case: Case) -> Outcome:
    """Return what a run with an event shows."""
    event = int(np.searchsorted(record.stamps, round(EVENT_TIME * 1e9)))
    slides = record.true_sliding > SLIDING
    after = slides[event:].any(axis=1)
    onset = event + int(after.argmax()) if after.any() else None
    least = least_at(record, scenario, scenario.duration, event)
    slid = record.true_slid
    slip = float(np.nanmax(slid - slid[event]))
    gone = not np.isfinite(record.true_positions[-1]).all()
    held = float(record.true_forces[event, :, 1].sum())
    peak = float(np.nanmax(record.true_forces[event:, :, 1].sum(axis=1)))
    return Outcome(
        case=case,
        onset=math.nan if onset is None else float(record.times[onset]),
        detection=math.nan if onset is None else _detection(record, onset, slides[onset]),
        reaction=math.nan if onset is None else _reaction(record, event, onset),
        slip=slip,
        early_slip=float(np.nanmax(slid[event])),
        false_alarms=false_alarms(record.part(slice(0, event))),
        excess=least / held if held > 0.0 else math.inf,
        survivable=least <= scenario.slip_regulator.maximum,
        lost=gone or slip > LOST_SLIDE,
        caught=not gone and not slides[-5:].any(),
        peak=peak / least if least > 0.0 else math.inf,
    )


def _detection(record: Record, onset: int, first: NDArray[np.bool_]) -> float:
    alarms = (record.grip[onset:, first] == 2).any(axis=1)
    return float(record.times[alarms.argmax()] - record.times[0]) if alarms.any() else math.inf


def _reaction(record: Record, event: int, onset: int) -> float:
    # Until the alarm the squeeze may also fall; what counts is that it rises above where it was.
    before = record.grasp_force[event]
    risen = record.grasp_force[event:] > RISEN * before
    rise = event + int(risen.argmax())
    return float(record.times[rise] - record.times[onset]) if risen.any() else math.inf


def false_alarms(record: Record) -> int:
    """Count alarms that begin while no contact slides nor has lately."""
    slips = record.grip == 2
    begins = slips[1:] & ~slips[:-1]
    moving = (record.true_sliding > 0.1 * SLIDING).any(axis=1)
    recent = np.convolve(moving, np.ones(50))[: len(record)] > 0.0
    return int((begins & ~recent[1:, None]).sum())


def hold_case(case: Case, kind: str) -> Held:
    """Hold the object of a case without any event and compare the squeeze in the end.

    Args:
        case: What is varied.
        kind: ``known``: as in the short runs; ``unknown``: friction and squeeze by default.
    """
    changes: dict[str, Any] = {
        "duration": HELD[kind],
        "plant__friction_changes": [],
        "plant__disturbances": [],
    }
    if kind == "unknown":
        base = load_scenario("gravity").slip_regulator
        changes["slip_regulator__friction__prior"] = base.friction.prior
        changes["slip_regulator__grasp_force"] = base.grasp_force
    scenario = scenario_of(case, **changes)
    record = ClosedLoop(scenario).run()
    tail = slice(-200, None)
    least = least_at(record, scenario, scenario.duration, -1)
    squeeze = float(record.true_forces[tail, :, 1].sum(axis=1).mean())
    return Held(
        case=case,
        kind=kind,
        ratio=squeeze / least,
        estimate=float(record.friction[-1].max()) / case.friction,
        slip=float(np.nanmax(record.true_slid)),
    )


def tasks_of(runs: int, seed: int) -> list[tuple[Case, str]]:
    """Return all runs: those with an event, some with the same pull, and a few held for longer."""
    cases = sample_cases(runs, seed)
    long, same = (cases[:: min(runs, every)] for every in (100, 40))
    # The longest first, so that no core waits for one at the end.
    out = [(case, kind) for kind in sorted(HELD, key=lambda k: -HELD[k]) for case in long]
    out += [(pull_of(case), "pull") for case in same]
    return out + [(case, "event") for case in cases]


def pull_of(case: Case) -> Case:
    """Return 10 N at once on 0.2 kg with mu = 0.5, felt at 1 kHz with a case's noise and delay."""
    load, down = 1.0 + 10.0 / (9.81 * 0.2), (0.0, 0.0, -1.0)
    return replace(case, event="step", friction=0.5, mass=0.2, rate=1000.0, load=load, pull=down)


def _run(case: Case, kind: str) -> tuple[str, Outcome | Held]:
    return kind, hold_case(case, kind) if kind in HELD else run_case(case)


def run_tasks(tasks: Sequence[tuple[Case, str]], jobs: int) -> Iterator[tuple[str, Outcome | Held]]:
    """Run on all cores and yield what is done, in any order.

    Raises:
        MissingLibraryError: If joblib is not installed.
    """
    joblib = optional("joblib", "Running the study on several cores")
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    with _interrupts_held_back():
        results = work(joblib.delayed(_run)(*task) for task in tasks)
    yield from results  # joblib ends its processes when this is left early


def run_study(
    runs: int, seed: int, jobs: int = -1, progress: Callable[[str], None] = lambda _: None
) -> Study:
    """Run the study.

    Args:
        runs: Number of runs with an event.
        seed: The same seed gives the same numbers, on any number of cores.
        jobs: Number of processes; -1 for one on each core.
        progress: Called whenever a run is done.
    """
    found: dict[str, list[Any]] = {kind: [] for kind in ("event", "pull", *HELD)}
    for kind, result in run_tasks(tasks_of(runs, seed), jobs):
        found[kind].append(result)
        progress(f"{kind}, run {result.case.index}")
    for results in found.values():
        results.sort(key=lambda result: result.case.index)
    held = [result for kind in HELD for result in found[kind]]
    return Study(seed, found["event"], found["pull"], held)


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
    medians = _rank(np.sort(known[picks], axis=1).T, 0.5)
    low, high = _rank(np.sort(medians), 0.025), _rank(np.sort(medians), 0.975)
    middle = [_rank(known, share) for share in (0.5, 0.9, 0.99)]
    return Estimate(len(known), float(middle[0]), float(low), float(high), *map(float, middle[1:]))


def _rank(ordered: Array, share: float) -> Any:
    """Return a percentile that is one of the values: there is nothing between 1 and infinity."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def share(flags: Sequence[bool]) -> tuple[float, float, float]:
    """Return a share with its 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    n, z = len(flags), 1.96
    if not n:
        return math.nan, math.nan, math.nan
    p = sum(flags) / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return p, max(0.0, middle - half), min(1.0, middle + half)


COLUMNS = ("", "runs", "median", "95 % interval", "90 %", "99 %", "goal")


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


SHARE_COLUMNS = ("", "runs", "share", "95 % interval")


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
        "of these: lost": [o.lost for o in survivable],
        "of these: at rest in the end": [o.caught for o in survivable],
        "of these: slid less than 1 mm": [o.slip < 1e-3 for o in survivable],
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
