# SPDX-License-Identifier: Apache-2.0
"""What a run of the slip study shows: delays, distances and squeezes against the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.slip.cases import EVENT_TIME, SlipCase, scenario_of
from studies.slip.survival import least_at
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

SLIDING = 1e-3  # m/s; slower sliding is creep of contacts that hold
RISEN = 1.02  # squeeze against that before the event, from which it counts as a reaction
LOST_SLIDE = 0.02  # m; as far as this no grasp is left
HELD = {"known": 2.0, "unknown": 12.0}  # duration of the runs that nothing disturbs, s


@dataclass(frozen=True)
class SlipOutcome:
    """What came out of a run; times are against the true onset, NaN where there was none.

    Attributes:
        case: What was varied.
        onset: First tick with a sliding contact after the event, s; NaN if it slid already.
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

    case: SlipCase
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

    case: SlipCase
    kind: str
    ratio: float
    estimate: float
    slip: float


def run_case(case: SlipCase) -> SlipOutcome:
    """Run a case and measure it."""
    scenario = scenario_of(case)
    return measure(ClosedLoop(scenario).run(), scenario, case)


def measure(record: Record, scenario: Scenario, case: SlipCase) -> SlipOutcome:
    """Return what a run with an event shows."""
    event = int(np.searchsorted(record.stamps, round(EVENT_TIME * 1e9)))
    slides = record.true_sliding > SLIDING
    after = slides[event:].any(axis=1)
    # What slid already has no onset after the event.
    fresh = after.any() and not slides[max(0, event - 5) : event].any()
    onset = event + int(after.argmax()) if fresh else None
    least = least_at(record, scenario, scenario.duration, event)
    slid = record.true_slid
    slip = float(np.nanmax(slid - slid[event]))
    gone = not np.isfinite(record.true_positions[-1]).all()
    lost = gone or slip > LOST_SLIDE
    held = float(record.true_forces[event, :, 1].sum())
    peak = float(np.nanmax(record.true_forces[event:, :, 1].sum(axis=1)))
    return SlipOutcome(
        case=case,
        onset=math.nan if onset is None else float(record.times[onset]),
        detection=math.nan if onset is None else _detection(record, onset, slides[onset]),
        reaction=math.nan if onset is None else _reaction(record, event, onset),
        slip=slip,
        early_slip=float(np.nanmax(slid[event])),
        false_alarms=false_alarms(record.part(slice(0, event))),
        excess=least / held if held > 0.0 else math.inf,
        survivable=least <= scenario.slip_regulator.maximum,
        lost=lost,
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


def hold_case(case: SlipCase, kind: str) -> Held:
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
