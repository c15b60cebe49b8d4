# SPDX-License-Identifier: Apache-2.0
"""Random loads on a grasp at rest: how often it is lost, against how hard it squeezes before.

A grasp that knows its object and has relaxed to its need and reserve is hit by a load that nothing
has announced. What no hand could hold is told by linear programming and does not count.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import tactile_hand_ros
from studies.slip.survival import least_against
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.style import PAGE, finger_color, look, new_figure
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.sweep.engine import Point, Study
from tactile_hand_ros.sweep.space import Choice, Space
from tactile_hand_ros.sweep.statistics import share_of
from tactile_hand_ros.sweep.table import (
    FAILED,
    LAST_COLUMNS,
    LOST,
    MISSED,
    REACHED,
    Store,
    Tally,
    keep,
    read_column,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

KINDS = ("step", "pulse", "ramp", "sine")
LAYOUTS = ("three_faces", "pinch")
DEFAULT = (3.0, 0.2)
"""Floor, N, and share of the reserve that a hand keeps by default."""

RESERVES = tuple((floor, share) for floor in (0.0, 1.0, 2.0, 3.0, 5.0) for share in (0.1, 0.2, 0.4))
"""Floors, N, and shares of the reserve that are compared."""

EVENT_TIME, DURATION = 0.3, 0.7  # s
SLIDE = 5e-3  # m; farther than that a load has moved the object in the hand
RESULTS = ("squeeze", "need", "survivable", "slip")
"""What a row of the table has of a `LoadOutcome`, beside `outcome`."""

COLUMNS: dict[str, type] = {
    "load": int,
    "layout": str,
    "mass": float,
    "friction": float,
    "kind": str,
    "duration": float,
    "force": str,
    "torque": str,
    "floor": float,
    "share": float,
    "squeeze": float,
    "need": float,
    "survivable": bool,
    "slip": float,
    **LAST_COLUMNS,
}
UNITS = {"mass": "kg", "duration": "s", "force": "N", "torque": "N m", "slip": "m"}
UNITS |= {name: "N" for name in ("floor", "squeeze", "need")}

_INERTIA = 0.0113  # of a uniform cube of this size, per mass, m^2
_RESERVED = ("slip_regulator.reflex.need", "force_optimizer")  # who keep a reserve
_RELAXING = {"release_rate": 500.0, "release_time": 0.02}  # until the load comes


@dataclass(frozen=True)
class LoadCase:
    """A load, and what it acts on.

    Attributes:
        index: Number of the case; it seeds the sensor.
        layout: Layout of the fingers.
        mass: Mass of the object, kg.
        friction: mu, which the hand knows.
        kind: Course of the load over time.
        duration: How long it lasts or rises, s.
        force: Force at its largest, N.
        torque: Torque at its largest, N m.
    """

    index: int
    layout: str
    mass: float
    friction: float
    kind: str
    duration: float
    force: tuple[float, float, float]
    torque: tuple[float, float, float]


@dataclass(frozen=True)
class LoadOutcome:
    """What a load did to a grasp.

    Attributes:
        floor: Floor of the reserve, N.
        share: Share of the largest recent load that it is at least.
        squeeze: k_f before the load came, N.
        need: Least squeeze that held then, N.
        survivable: Whether a grasp inside the crush limit can carry it.
        lost: Whether a contact was gone at the end.
        slip: Largest distance that a contact slid because of it, m.
    """

    floor: float
    share: float
    squeeze: float
    need: float
    survivable: bool
    lost: bool
    slip: float

    @property
    def slid(self) -> bool:
        """Whether the object slid farther than `SLIDE`, or was lost."""
        return self.lost or not self.slip <= SLIDE


def sample_loads(runs: int, seed: int) -> list[LoadCase]:
    """Return random loads; the same seed gives the same ones."""
    random = np.random.default_rng(seed)
    cases = []
    for index in range(runs):
        force, torque = (_direction(random) for _ in range(2))
        force *= random.uniform(1.0, 12.0)
        torque *= random.uniform(0.0, 0.3)
        cases.append(
            LoadCase(
                index=index,
                layout=LAYOUTS[int(random.integers(2))],
                mass=0.05 * 8.0 ** float(random.random()),
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


@functools.cache
def _start(layout: str) -> tuple[Contacts, Array]:
    """Return contacts and centre of mass at the start, in a layout."""
    plant = Plant(load_scenario("gravity", {"layout": layout, "targets": []}).plant)
    return plant.state.contacts, plant.state.position


def scenario_of(
    case: LoadCase, floor: float, share: float = DEFAULT[1], **changes: Any
) -> Scenario:
    """Return the scenario of a load, with a reserve.

    Args:
        case: The load.
        floor: Floor of the reserve, N.
        share: Share of the largest recent load that the reserve is at least.
        changes: Values by dotted key with two underscores for a dot.
    """
    centroid = _start(case.layout)[0].centroid.tolist()
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
        "targets": [{"time": 0.0, "position": centroid}],
        "plant.object.mass": case.mass,
        "plant.object.inertia": [_INERTIA * case.mass] * 3,
        "plant.object.friction": case.friction,
        "plant.disturbances": [load],
        "slip_regulator.friction.prior": case.friction,
        **{f"{place}.reserve.floor": floor for place in _RESERVED},
        **{f"{place}.reserve.share": share for place in _RESERVED},
        **{key.replace("__", "."): value for key, value in changes.items()},
    }
    return load_scenario("gravity", values)


def run_load(
    case: LoadCase, floor: float, share: float = DEFAULT[1], **changes: Any
) -> LoadOutcome:
    """Let a load act on a relaxed grasp and measure what it did; see `scenario_of`."""
    scenario = scenario_of(case, floor, share, **changes)
    least = _least(case, (1.0, -1.0) if case.kind == "sine" else (1.0,))
    record = relaxed_run(scenario, round(EVENT_TIME * scenario.plant.rate))
    event = int(np.searchsorted(record.stamps, round(EVENT_TIME * 1e9)))
    slid = record.true_slid
    return LoadOutcome(
        floor=floor,
        share=share,
        squeeze=float(record.grasp_force[event]),
        need=_least(case, ()),
        survivable=least <= scenario.slip_regulator.maximum,
        lost=not bool(np.isfinite(record.true_positions[-1]).all()),
        slip=float(np.nanmax(slid[-1] - slid[event])),
    )


def relaxed_run(scenario: Scenario, event: int) -> Record:
    """Run a scenario whose squeeze falls to what is wanted within the ticks before an event."""
    loop = ClosedLoop(scenario)
    config = scenario.slip_regulator
    quick = config.model_copy(update={"reflex": config.reflex.model_copy(update=_RELAXING)})
    loop.regulator.configure(quick)
    hand = loop.plant.hand
    record = Record.empty(scenario.ticks, hand.finger_names, hand.joint_names)
    for row in range(scenario.ticks):
        if row == event:
            loop.regulator.configure(config)
        loop.tick(record, row)
    return record


def _least(case: LoadCase, shares: Sequence[float]) -> float:
    """Return the least squeeze against the weight and some shares of the load besides, N."""
    contacts, position = _start(case.layout)
    weight = np.array([0.0, 0.0, -9.81 * case.mass, 0.0, 0.0, 0.0])
    load = np.array([*case.force, *case.torque])
    wrenches = [weight + share * load for share in (0.0, *shares)]
    return max(least_against(contacts, position, w, case.friction) for w in wrenches)


def study_of(runs: int, seed: int, reserves: Sequence[tuple[float, float]] = RESERVES) -> Study:
    """Return the same random loads on grasps with each reserve as a study.

    Args:
        runs: Number of loads.
        seed: The same seed gives the same loads.
        reserves: Floors, N, and shares of the reserve.
    """
    space = Space(
        {"case": Choice(tuple(sample_loads(runs, seed))), "reserve": Choice(tuple(reserves))}
    )
    return Study(space, "grid", run_one, seed=seed)


def run_one(point: Point) -> dict[str, Any]:
    """Let the load of a point act on a grasp with its reserve and return what came of it."""
    came = run_load(point.values["case"], *point.values["reserve"])
    outcome = LOST if came.lost else MISSED if came.slid else REACHED
    found = {name: getattr(came, name) for name in RESULTS}
    return {**found, "outcome": outcome}


def run_loads(
    runs: int,
    seed: int,
    folder: Path,
    reserves: Sequence[tuple[float, float]] = RESERVES,
    watch: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Make all runs that are not done yet, where `workers` says, and write their table.

    Args:
        runs: Number of loads.
        seed: The same seed gives the same loads.
        folder: Of the results; holds those of an earlier, unfinished call.
        reserves: Floors, N, and shares of the reserve.
        watch: Called after each run.

    Raises:
        StudyError: If the folder holds another study or cannot be written.
    """
    description = {
        "version": tactile_hand_ros.__version__,
        "loads": runs,
        "seed": seed,
        "reserves": [list(reserve) for reserve in reserves],
    }
    store = Store(folder, COLUMNS, UNITS)
    return keep(study_of(runs, seed, reserves), store, description, _parameters, watch)


def _parameters(point: Point) -> dict[str, Any]:
    case = asdict(point.values["case"])
    floor, share = point.values["reserve"]
    return {"load": case.pop("index"), **case, "floor": floor, "share": share}


def outcomes_of(folder: Path) -> list[LoadOutcome]:
    """Return what the table of a study shows; a run that failed counts as a loss."""
    names = ("floor", "share", *RESULTS, "outcome")
    rows = zip(*(read_column(folder, name).tolist() for name in names), strict=True)
    return [
        LoadOutcome(
            floor,
            share,
            squeeze,
            need,
            survivable=came == FAILED or bool(survivable),
            lost=came in (LOST, FAILED),
            slip=slip,
        )
        for floor, share, squeeze, need, survivable, slip, came in rows
    ]


@dataclass(frozen=True)
class TradeOff:
    """Comfort and safety with one reserve, over the loads that can be survived.

    Attributes:
        floor: Floor of the reserve, N.
        share: Its share of the largest recent load.
        runs: Number of loads.
        squeeze: Mean squeeze before the load, N.
        need: Mean of the least squeeze that held then, N.
        lost: Number of objects that were lost.
        slid: Number of those that slid farther than `SLIDE`, or were lost.
    """

    floor: float
    share: float
    runs: int
    squeeze: float
    need: float
    lost: int
    slid: int


def trade_offs(outcomes: Sequence[LoadOutcome]) -> list[TradeOff]:
    """Return comfort and safety for each reserve."""
    curve = []
    for floor, share in sorted({(o.floor, o.share) for o in outcomes}):
        some = [o for o in outcomes if (o.floor, o.share) == (floor, share) and o.survivable]
        squeeze, need = _mean([o.squeeze for o in some]), _mean([o.need for o in some])
        lost, slid = sum(o.lost for o in some), sum(o.slid for o in some)
        curve.append(TradeOff(floor, share, len(some), squeeze, need, lost, slid))
    return curve


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


LABELS = {"slid": "slid over 5 mm", "lost": "lost"}
HEADS = ("floor", "share", "loads", "squeeze before", "over need", "lost", "slid over 5 mm")


def rows(outcomes: Sequence[LoadOutcome]) -> list[list[str]]:
    """Return the curve as text, columns as in `HEADS`."""
    return [_row(point) for point in trade_offs(outcomes)]


def _row(point: TradeOff) -> list[str]:
    reserve = [f"{point.floor:g} N", f"{100 * point.share:g} %", str(point.runs)]
    squeeze = [f"{point.squeeze:.1f} N", f"{point.squeeze / point.need:.1f}"]
    return reserve + squeeze + [_text(point.lost, point.runs), _text(point.slid, point.runs)]


def _text(count: int, runs: int) -> str:
    value, low, high = share_of(count, runs)
    return f"{100 * value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def loads_figure(outcomes: Sequence[LoadOutcome]) -> Figure:
    """Draw what slides and what is lost against the squeeze before the load, per least squeeze."""
    curve = trade_offs(outcomes)
    with look():
        figure = new_figure(PAGE, 2.6)
        axes = figure.subplots()
        for share, marker in zip(sorted({point.share for point in curve}), "svo^", strict=False):
            some = [point for point in curve if point.share == share]
            over = [point.squeeze / point.need for point in some]
            for i, name in enumerate(("slid", "lost")):
                shares = [100.0 * getattr(point, name) / max(point.runs, 1) for point in some]
                label = f"{LABELS[name]}, share {100 * share:g} %"
                axes.plot(over, shares, f"{marker}-", color=finger_color(i), ms=3.5, label=label)
        for point in some:
            place = point.squeeze / point.need, 100.0 * point.slid / max(point.runs, 1)
            axes.annotate(f" {point.floor:g} N", place, fontsize=7, va="bottom")
        axes.set_xlabel("mean squeeze before the load per least squeeze, by floor of the reserve")
        axes.set_ylabel("share of the loads [%]")
        axes.legend()
    return figure


def write(outcomes: Sequence[LoadOutcome], folder: Path) -> Path:
    """Write the table as Markdown and return the file."""
    report = folder / "study_loads.md"
    report.write_text(tables.markdown(HEADS, rows(outcomes)), encoding="utf-8")
    return report
