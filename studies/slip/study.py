# SPDX-License-Identifier: Apache-2.0
"""The slip study: how fast slip is detected and stopped, and at what grasp force.

Every run starts with the prior friction and 1.3 times the minimum grasp force for the lower of the
prior and the true friction. Then the surface becomes slippery, or the object is pulled. A few
longer runs without an event measure the grasp force at rest.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.slip.minimum import initial_grasp, minimum_against, minimum_at
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.extras import optional
from tactile_hand_ros.report import tables
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.sweep.engine import LOST, MISSED, REACHED, Point, Study
from tactile_hand_ros.sweep.results import fraction_of, median_interval, rank
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.table import Table

LOADS = {"friction": (1.2, 3.5), "step": (1.5, 8.0), "ramp": (1.5, 8.0)}
EVENTS = tuple(LOADS)
RATES = (250.0, 500.0, 1000.0)
EVENT_TIME, DURATION, RAMP = 0.07, 0.19, 0.05  # s
HELD = {"known": 2.0, "unknown": 12.0}
"""Duration of the runs without an event, with known or unknown friction [s]."""

SLIDING = 1e-3  # m/s; slower sliding is creep of sticking contacts
LOST_SLIDE = 0.02  # m; beyond it, the object counts as lost
_RISEN = 1.02  # grasp force relative to that before the event that counts as a reaction


@dataclass(frozen=True)
class HandRange:
    """Objects of a hand: scenario, range of masses [kg], and a pull [N] on a mass [kg]."""

    scenario: str
    masses: tuple[float, float]
    pull: float
    pulled: float


HANDS = {
    "paper": HandRange("gravity", (0.05, 0.5), 10.0, 0.2),
    "human": HandRange("human_hold", (0.02, 0.2), 2.0, 0.1),
}


@dataclass(frozen=True)
class SlipCase:
    """The varied quantities of a run.

    Attributes:
        index: Number of the case; it seeds the sensor.
        event: The event, of `EVENTS`.
        friction: mu before the event.
        mass: Mass of the object [kg].
        noise: Standard deviation of each force component [N].
        latency: Age of a tactile sample [s].
        rate: Samples per second [Hz].
        load: Minimum grasp force after the event relative to that before it.
        pull: Direction of the pull.
        hand: The hand, of `HANDS`.
        kind: ``event``, ``pull`` for cases with the same pull, or one of `HELD`, without an event.
    """

    index: int
    event: str
    friction: float
    mass: float
    noise: float
    latency: float
    rate: float
    load: float
    pull: tuple[float, float, float]
    hand: str = "paper"
    kind: str = "event"


def sample_cases(runs: int, seed: int, hand: str = "paper") -> list[SlipCase]:
    """Return cases from Latin-hypercube sampling of the ranges."""
    qmc = optional("scipy.stats.qmc", "The slip study")
    cases = []
    for i, u in enumerate(qmc.LatinHypercube(d=9, seed=np.random.default_rng(seed)).random(runs)):
        angle, tilt = 2.0 * math.pi * u[7], 0.5 * u[8]
        sideways, event = math.sin(tilt), EVENTS[int(3 * u[0])]
        cases.append(
            SlipCase(
                index=i,
                event=event,
                friction=_between(0.2, 1.0, u[1]),
                mass=_between(*HANDS[hand].masses, u[2]),
                noise=_between(0.002, 0.03, u[3]),
                latency=round(0.01 * u[4], 4),
                rate=RATES[int(3 * u[5])],
                load=_between(*LOADS[event], u[6]),
                pull=(sideways * math.cos(angle), sideways * math.sin(angle), -math.cos(tilt)),
                hand=hand,
            )
        )
    return cases


def _between(low: float, high: float, fraction: float) -> float:
    """Return a value at a fraction of a range, on a logarithmic scale."""
    return float(low * (high / low) ** fraction)


def pull_of(case: SlipCase) -> SlipCase:
    """Return the hand's pull with mu = 0.5, at 1 kHz with a case's noise and latency."""
    of = HANDS[case.hand]
    load, down = 1.0 + of.pull / (9.81 * of.pulled), (0.0, 0.0, -1.0)
    same = replace(case, friction=0.5, mass=of.pulled, rate=1000.0, load=load, pull=down)
    return replace(same, kind="pull", event="step")


@functools.cache
def _base(hand: str) -> Scenario:
    return load_scenario(HANDS[hand].scenario)


def scenario_of(case: SlipCase, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Return the scenario of a case with its event; changes by dotted key take precedence."""
    base = _base(case.hand).slip_regulator
    contacts, position = initial_grasp(HANDS[case.hand].scenario)
    wrench = np.array([0.0, 0.0, -9.81 * case.mass, 0.0, 0.0, 0.0])
    prior = base.friction.prior
    minimum = minimum_against(contacts, position, wrench, min(prior, case.friction))
    values = {
        "duration": DURATION,
        "seed": case.index + 1,
        "targets": [],
        "plant.object.mass": case.mass,
        "plant.object.friction": case.friction,
        "tactile_sensor.force_noise": case.noise,
        "tactile_sensor.latency": case.latency,
        "tactile_sensor.rate": case.rate,
        "slip_regulator.grasp_force": min(max(1.3 * minimum, base.minimum), base.maximum),
        **_event(case),
        **(changes or {}),
    }
    return load_scenario(HANDS[case.hand].scenario, values)


def _event(case: SlipCase) -> dict[str, Any]:
    if case.event == "friction":
        change = {"start": EVENT_TIME, "friction": case.friction / case.load}
        return {"plant.friction_changes": [change]}
    force = [9.81 * case.mass * (case.load - 1.0) * x for x in case.pull]
    push = {"kind": case.event, "start": EVENT_TIME, "duration": RAMP, "force": force}
    return {"plant.disturbances": [push]}


def study_of(runs: int, seed: int, hand: str = "paper") -> Study:
    """Return the study of a hand: a few long holds, some with the same pull, and the events."""
    cases = sample_cases(runs, seed, hand)
    long, same = (cases[:: min(runs, every)] for every in (200, 40))
    # The longest first, so that no core is idle at the end.
    held = [replace(case, kind=kind) for kind in ("unknown", "known") for case in long]
    chosen = Choice((*held, *map(pull_of, same), *cases))
    return Study({"case": chosen}, run_one, runs, seed)


def run_one(point: Point) -> dict[str, Any]:
    """Make a run and return its measurements and outcome."""
    case = point.values["case"]
    if case.kind in HELD:
        return {**hold_case(case), "outcome": REACHED}
    scenario = scenario_of(case)
    found = measure(ClosedLoop(scenario).run(), scenario)
    outcome = LOST if found["lost"] else REACHED if found["caught"] else MISSED
    return {**found, "outcome": outcome}


def measure(record: Record, scenario: Scenario) -> dict[str, float]:
    """Return the measurements of a run with an event.

    onset: First tick with a sliding contact after the event [s]; NaN if one slid before.
    detection: From onset to the first alarm of that contact [s]; infinite without an alarm.
    reaction: From onset to the rise of the grasp force [s]; negative if it rose before.
    slip, early_slip: Largest distance that a contact slid after and before the event [m].
    false_alarms: Number of alarms before the event while no contact slid.
    excess: Minimum grasp force after the event relative to the grasp force at the event.
    survivable: Whether a grasp within the crush limit can carry the load after the event.
    lost, caught: Whether the object is gone or slid far, and whether it rests at the end.
    peak: Largest sum of normal forces after the event relative to the minimum after it.
    """
    event = int(np.searchsorted(record.stamps, round(EVENT_TIME * 1e9)))
    slides = record.true_sliding > SLIDING
    after = slides[event:].any(axis=1)
    # Contacts that were already sliding have no onset after the event.
    fresh = after.any() and not slides[max(0, event - 5) : event].any()
    onset = event + int(after.argmax()) if fresh else None
    minimum = minimum_at(record, scenario, scenario.duration, event)
    slip = float(np.nanmax(record.true_slid - record.true_slid[event]))
    gone = not np.isfinite(record.true_positions[-1]).all()
    held = float(record.true_forces[event, :, 1].sum())
    peak = float(np.nanmax(record.true_forces[event:, :, 1].sum(axis=1)))
    return {
        "onset": math.nan if onset is None else float(record.times[onset]),
        "detection": math.nan if onset is None else _detection(record, onset, slides[onset]),
        "reaction": math.nan if onset is None else _reaction(record, event, onset),
        "slip": slip,
        "early_slip": float(np.nanmax(record.true_slid[event])),
        "false_alarms": float(false_alarms(record.part(slice(0, event)))),
        "excess": minimum / held if held > 0.0 else math.inf,
        "survivable": float(minimum <= scenario.slip_regulator.maximum),
        "lost": float(gone or slip > LOST_SLIDE),
        "caught": float(not gone and not slides[-5:].any()),
        "peak": peak / minimum if minimum > 0.0 else math.inf,
    }


def _detection(record: Record, onset: int, first: NDArray[np.bool_]) -> float:
    alarms = (record.grip[onset:, first] == ContactState.SLIP).any(axis=1)
    return float(record.times[alarms.argmax()] - record.times[0]) if alarms.any() else math.inf


def _reaction(record: Record, event: int, onset: int) -> float:
    # The grasp force may also fall until the alarm; the reaction is a rise above the level before.
    risen = record.grasp_force[event:] > _RISEN * record.grasp_force[event]
    rise = event + int(risen.argmax())
    return float(record.times[rise] - record.times[onset]) if risen.any() else math.inf


def false_alarms(record: Record) -> int:
    """Count alarms that start while no contact slides or has slid recently."""
    slips = record.grip == ContactState.SLIP
    begins = slips[1:] & ~slips[:-1]
    moving = (record.true_sliding > 0.1 * SLIDING).any(axis=1)
    recent = np.convolve(moving, np.ones(50))[: len(record)] > 0.0
    return int((begins & ~recent[1:, None]).sum())


def hold_case(case: SlipCase) -> dict[str, float]:
    """Hold the object of a case without an event and compare the grasp force at the end.

    With ``known`` friction the prior is the true friction; ``unknown`` uses the defaults.
    Ratio: sum of normal forces at the end relative to the minimum; estimate: largest friction
    estimate relative to the true friction; slip: largest distance that a contact slid [m].
    """
    changes: dict[str, Any] = {
        "duration": HELD[case.kind],
        "plant.friction_changes": [],
        "plant.disturbances": [],
    }
    if case.kind == "known":
        changes["slip_regulator.friction.prior"] = case.friction
        changes["slip_regulator.friction.explore"] = 0.0
    else:
        changes["slip_regulator.grasp_force"] = _base(case.hand).slip_regulator.grasp_force
    scenario = scenario_of(case, changes)
    record = ClosedLoop(scenario).run()
    held = float(record.true_forces[-200:, :, 1].sum(axis=1).mean())
    return {
        "ratio": held / minimum_at(record, scenario, scenario.duration, -1),
        "estimate": float(record.friction[-1].max()) / case.friction,
        "slip": float(np.nanmax(record.true_slid)),
    }


def _some(table: Table, chosen: NDArray[np.bool_]) -> Table:
    """Return the columns of some runs."""
    return {name: column[chosen] for name, column in table.items()}


def _slipped(table: Table) -> Table:
    return _some(table, (table["kind"] == "event") & np.isfinite(table["onset"]))


COLUMNS = ("", "runs", "median", "95 % interval", "90 %", "99 %", "goal")
FRACTION_COLUMNS = ("", "runs", "fraction", "95 % interval")


def rows(table: Table) -> list[list[str]]:
    """Return the results as text, with the columns of `COLUMNS`."""
    slipped = _slipped(table)
    fast = _some(slipped, slipped["rate"] == 1000.0)
    prompt = _some(fast, fast["latency"] <= 0.002)
    out = []
    for name, goal in (("detection", "< 10 ms"), ("reaction", "< 20 ms")):
        for among, some in (("", slipped), (", 1 kHz", fast), (", 1 kHz, latency <= 2 ms", prompt)):
            out.append(_row(name + among, 1e3 * some[name], "ms", goal))
    kept = _some(slipped, slipped["survivable"] > 0.0)
    for event in EVENTS:
        slips = 1e3 * kept["slip"][kept["event"] == event]
        out.append(_row(f"slip distance, {event}", slips, "mm"))
    pulls = 1e3 * table["slip"][table["kind"] == "pull"]
    out.append(_row("slip distance, the same pull, mu 0.5", pulls, "mm", "< 1 mm"))
    out.append(_row("largest grasp force / minimum", kept["peak"]))
    for kind in HELD:
        ratios = table["ratio"][table["kind"] == kind]
        out.append(_row(f"steady grasp force / minimum, mu {kind}", ratios, goal="< 1.4"))
    return out


def _row(name: str, values: Array, unit: str = "", goal: str = "") -> list[str]:
    known = np.sort(values[~np.isnan(values)])
    middle, low, high = median_interval(known)
    tail = [float(rank(known, f)) if len(known) else math.nan for f in (0.9, 0.99)]
    numbers = [f"{_text(middle)} {unit}".rstrip(), f"{_text(low)} to {_text(high)}"]
    if goal and not middle < float(goal.split()[1]):
        goal += ", missed"
    return [name, str(len(known)), *numbers, *map(_text, tail), goal]


def _text(value: float) -> str:
    return "never" if math.isinf(value) else tables.number(float(f"{value:.3g}"))


def fraction_rows(table: Table) -> list[list[str]]:
    """Return the frequency of events as text, with the columns of `FRACTION_COLUMNS`."""
    events, slipped = _some(table, table["kind"] == "event"), _slipped(table)
    possible = _some(events, events["survivable"] > 0.0)
    flags = {
        "slipped": np.isfinite(events["onset"]),
        "alarm within 10 ms of slipping": slipped["detection"] <= 0.01,
        "any alarm after slipping": np.isfinite(slipped["detection"]),
        "grasp force rose within 20 ms of slipping": slipped["reaction"] <= 0.02,
        "no alarm without slip before the event": events["false_alarms"] == 0,
        "slid before the event": events["early_slip"] > 1e-5,
        "a grasp within the crush limit can survive": events["survivable"] > 0.0,
        "survivable: lost": possible["lost"] > 0.0,
        "survivable: at rest at the end": possible["caught"] > 0.0,
        "survivable: slid less than 1 mm": possible["slip"] < 1e-3,
    }
    return [[name, str(len(f)), *_percent(int(f.sum()), len(f))] for name, f in flags.items()]


def _percent(count: int, n: int) -> tuple[str, str]:
    value, low, high = fraction_of(count, n)
    return f"{100 * value:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %"
