# SPDX-License-Identifier: Apache-2.0
"""Random loads on a grasp at rest: loss rate against the grasp force before the load.

The friction is known, and the grasp force has relaxed to the required force plus reserve, when an
unexpected load acts. Loads that no hand could hold are found by linear programming and excluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.slip.minimum import initial_grasp, minimum_against
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.sweep.engine import FAILED, LOST, MISSED, REACHED, Point, Study
from tactile_hand_ros.sweep.results import fraction_of
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.table import Table

KINDS = ("step", "pulse", "ramp", "sine")
DEFAULT = (0.6, 0.2)
"""The default reserve: floor per weight of a finger, and fraction of the largest recent load."""

RESERVES = {"floor": (0.0, 0.2, 0.4, 0.6, 1.0), "fraction": (0.1, 0.2, 0.4)}
"""Floors and fractions of the compared reserves, in all combinations."""

EVENT_TIME, DURATION = 0.3, 0.7  # s
SLIDE = 5e-3  # m; beyond it, the load has moved the object in the hand
_BITS = 14  # encoder resolution
_RELAXING = {"reflex.release_rate": 500.0, "reflex.release_time": 0.02}  # until the load


@dataclass(frozen=True)
class Range:
    """Loads of a hand: scenario, layouts, and ranges in SI units."""

    scenario: str
    layouts: tuple[str, ...]
    mass: tuple[float, float]
    force: tuple[float, float]
    torque: float


RANGES = {
    "paper": Range("gravity", ("three_faces", "pinch"), (0.05, 0.4), (1.0, 12.0), 0.3),
    "human": Range("human_hold", ("tripod",), (0.02, 0.3), (0.25, 4.0), 0.015),
}


@dataclass(frozen=True)
class LoadCase:
    """A load and its target.

    Attributes:
        index: Number of the case; it seeds the sensor.
        hand: Hand, of `RANGES`.
        layout: Layout of the fingers.
        down: Direction of gravity, palm frame.
        mass: Mass of the object, kg.
        friction: mu, known to the hand.
        kind: Course of the load over time.
        duration: Duration or rise time [s].
        force: Peak force [N].
        torque: Peak torque [N m].
    """

    index: int
    hand: str
    layout: str
    down: tuple[float, float, float]
    mass: float
    friction: float
    kind: str
    duration: float
    force: tuple[float, float, float]
    torque: tuple[float, float, float]


def sample_loads(runs: int, seed: int, hand: str = "paper") -> list[LoadCase]:
    """Return random loads on a hand; the same seed gives the same loads."""
    random, limits = np.random.default_rng(seed), RANGES[hand]
    low, high = limits.mass
    cases = []
    for index in range(runs):
        down, force, torque = (_direction(random) for _ in range(3))
        force *= random.uniform(*limits.force)
        torque *= random.uniform(0.0, limits.torque)
        cases.append(
            LoadCase(
                index=index,
                hand=hand,
                layout=limits.layouts[int(random.integers(len(limits.layouts)))],
                down=(float(down[0]), float(down[1]), float(down[2])),
                mass=low * (high / low) ** float(random.random()),
                friction=float(random.uniform(0.4, 1.0)),
                kind=KINDS[int(random.integers(4))],
                duration=float(random.uniform(0.02, 0.3)),
                force=(float(force[0]), float(force[1]), float(force[2])),
                torque=(float(torque[0]), float(torque[1]), float(torque[2])),
            )
        )
    return cases


def _direction(random: np.random.Generator) -> Array:
    vector = random.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def scenario_of(case: LoadCase, floor: float, fraction: float) -> Scenario:
    """Return the scenario of a load on a grasp with a reserve; see `DEFAULT`."""
    contacts, _ = initial_grasp(RANGES[case.hand].scenario, case.layout)
    load = {
        "kind": case.kind,
        "start": EVENT_TIME,
        "duration": max(case.duration, 0.25) if case.kind == "sine" else case.duration,
        "frequency": 4.0,
        "force": list(case.force),
        "torque": list(case.torque),
    }
    values: dict[str, Any] = {
        "duration": DURATION,
        "seed": case.index + 1,
        "layout": case.layout,
        "targets": [{"time": 0.0, "position": contacts.centroid.tolist()}],
        "gravity": [9.81 * x for x in case.down],
        "plant.encoder.bits": _BITS,
        "plant.object.mass": case.mass,
        "plant.object.friction": case.friction,
        "plant.disturbances": [load],
        "slip_regulator.friction.prior": case.friction,
        "slip_regulator.reserve.floor": floor,
        "slip_regulator.reserve.fraction": fraction,
    }
    return load_scenario(RANGES[case.hand].scenario, values)


def run_load(case: LoadCase, floor: float, fraction: float = DEFAULT[1]) -> dict[str, Any]:
    """Apply a load to a relaxed grasp and return the result.

    It contains k_f before the load [N], the minimum grasp force then [N], whether a grasp within
    the crush limit can carry the load, the largest slip distance under it [m], and the outcome.
    """
    scenario = scenario_of(case, floor, fraction)
    record = relaxed_run(scenario, round(EVENT_TIME * scenario.plant.rate))
    event = int(np.searchsorted(record.stamps, round(EVENT_TIME * 1e9)))
    minimum = _minimum(case, (1.0, -1.0) if case.kind == "sine" else (1.0,))
    slip = float(np.nanmax(record.true_slid[-1] - record.true_slid[event]))
    is_held = bool(np.isfinite(record.true_positions[-1]).all())
    return {
        "grasp_force": float(record.grasp_force[event]),
        "need": _minimum(case, ()),
        "survivable": minimum <= scenario.slip_regulator.maximum,
        "slip": slip,
        "outcome": LOST if not is_held else REACHED if slip <= SLIDE else MISSED,
    }


def relaxed_run(scenario: Scenario, event: int) -> Record:
    """Run a scenario in which the grasp force relaxes fully before the tick of an event."""
    loop = ClosedLoop(scenario)
    config = scenario.slip_regulator
    loop.regulator.configure(config.changed(_RELAXING))
    hand = loop.plant.hand
    record = Record.empty(scenario.ticks, hand.finger_names, hand.joint_names)
    for row in range(scenario.ticks):
        if row == event:
            loop.regulator.configure(config)
        loop.tick(record, row)
    return record


def _minimum(case: LoadCase, factors: Sequence[float]) -> float:
    """Return the minimum grasp force for the weight, alone and with multiples of the load."""
    contacts, position = initial_grasp(RANGES[case.hand].scenario, case.layout)
    weight = 9.81 * case.mass * np.array([*case.down, 0.0, 0.0, 0.0])
    load = np.array([*case.force, *case.torque])
    wrenches = [weight + factor * load for factor in (0.0, *factors)]
    return max(minimum_against(contacts, position, w, case.friction) for w in wrenches)


def study_of(
    runs: int,
    seed: int,
    reserves: Mapping[str, tuple[float, ...]] = RESERVES,
    hand: str = "paper",
) -> Study:
    """Return the study of the same loads on a hand of `RANGES`, with each of the reserves."""
    space = {"case": Choice(tuple(sample_loads(runs, seed, hand)))}
    space |= {name: Choice(values) for name, values in reserves.items()}
    return Study(space, run_one, runs, seed)


def run_one(point: Point) -> dict[str, Any]:
    """Apply the load of a point to a grasp with its reserve."""
    return run_load(**point.values)


HEADS = ("floor", "fraction", "loads", "grasp force before", "over need", "lost", "slid over 5 mm")


def rows(table: Table) -> list[list[str]]:
    """Return comfort and safety with each reserve over the survivable loads, columns as in `HEADS`.

    A failed run counts as a loss; an object that slid farther than `SLIDE` or was lost, as slid.
    """
    failed = table["outcome"] == FAILED
    possible = failed | (table["survivable"] == True)  # noqa: E712, missing if it failed
    lost = failed | (table["outcome"] == LOST)
    slid = lost | (table["outcome"] == MISSED)
    found = []
    for floor, fraction in sorted(set(zip(table["floor"], table["fraction"], strict=True))):
        some = possible & (table["floor"] == floor) & (table["fraction"] == fraction)
        runs = int(some.sum())
        before, need = (float(np.nanmean(table[name][some])) for name in ("grasp_force", "need"))
        numbers = str(runs), f"{before:.1f} N", f"{before / need:.1f}"
        counts = (_text(int(flags[some].sum()), runs) for flags in (lost, slid))
        found.append([f"{floor:g}", f"{100 * fraction:g} %", *numbers, *counts])
    return found


def _text(count: int, runs: int) -> str:
    value, low, high = fraction_of(count, runs)
    return f"{100 * value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
