# SPDX-License-Identifier: Apache-2.0
"""The same scenarios with both physics engines, and three facts of friction.

`make study NAME=engines` compares the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import perf_counter

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import hand_jacobian
from tactile_hand_ros.report.page import Result
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.mujoco_plant import make_plant
from tactile_hand_ros.simulation.plant import PlantState
from tactile_hand_ros.simulation.plant_config import Disturbance, ObjectConfig, PlantConfig

ENGINES = ("own", "mujoco")
COLUMNS = (
    "scenario",
    "outcome",
    "position error [mm]",
    "rotation error [rad]",
    "slid [mm]",
    "step [µs]",
    "paths differ while all stick, in all [mm]",
    "forces differ while all stick, median, 95 % [%]",
)
FRICTION_COLUMNS = ("", "own", "mujoco", "theory")
FRICTIONS = (0.2, 0.5, 1.0)

_STUCK = 1e-4  # a contact that has slid less sticks, m
_NORMAL = 10.0  # sum of the normal forces that hold the block, N
_RAMP = 2.0  # N/s, slow against the oscillations of the hold
_SLIDING = 1e-3  # all contacts are faster once the block slides, m/s


def _run(name: str, engine: str) -> tuple[Result, float]:
    """Return a run and the median time of an integration step, s.

    Tips are rigid, as MuJoCo ignores their compliance.
    """
    rigid = {"plant.engine": engine, "plant.contact.compliance": 0.0}
    scenario = load_scenario(name, rigid)
    spent: list[float] = []

    class Timed(ClosedLoop):
        def advance(self, torque: Array) -> None:
            start = perf_counter()
            super().advance(torque)
            spent.append(perf_counter() - start)

    record = Timed(scenario).run()
    return Result(record, scenario), float(np.median(spent)) / scenario.plant.steps_per_tick


def compare(name: str) -> list[str]:
    """Run a scenario with both engines and return its row of the table."""
    runs, steps = zip(*(_run(name, engine) for engine in ENGINES), strict=True)
    ours, other = (run.record for run in runs)
    n = min(len(ours), len(other))
    apart = 1e3 * np.linalg.norm(ours.object_position[:n] - other.object_position[:n], axis=1)
    slid = np.nanmax([ours.true_slid[:n], other.true_slid[:n]], axis=(0, 2))
    forces = [_forces(record.part(slice(n))) for record in (ours, other)]
    sticking = (slid < _STUCK) & (np.arange(n) > 0)  # at the first tick no force acts yet
    size = np.linalg.norm(forces[0], axis=2).max(axis=1)[sticking]
    off = np.linalg.norm(forces[0] - forces[1], axis=2).max(axis=1)[sticking] / size
    middle, high = 100.0 * np.percentile(off, [50, 95])
    metrics, until = [run.metrics for run in runs], ours.times[:n][sticking][-1]
    return [
        name,
        _both(run.headline for run in runs),
        _both(f"{1e3 * m.final_position_error_m:.3f}" for m in metrics),
        _both(f"{m.final_rotation_error_rad:.4f}" for m in metrics),
        _both(f"{1e3 * m.max_slip_distance_m:.2g}" for m in metrics),
        _both(f"{1e6 * step:.0f}" for step in steps),
        f"{apart[sticking].max():.3f} until {until:.1f} s, {apart.max():.3f}",
        f"{middle:.2f}, {high:.2f}",
    ]


def _both(texts: Iterable[str]) -> str:
    return " / ".join(dict.fromkeys(texts))


def _forces(record: Record) -> Array:
    """Return the true forces in palm axes, shape (n, k, 3), N; 0 without a contact."""
    rotations = np.nan_to_num(rotation_from_quaternion(record.true_quaternions))
    return np.asarray(np.einsum("tkij,tkj->tki", rotations, record.true_forces))


def friction_rows() -> list[list[str]]:
    """Return the pulls at which a block starts to slide, and its creep under half of one."""
    rows = []
    for friction in FRICTIONS:
        pulls = [f"{_pull_at_slip(engine, friction):.3f}" for engine in ENGINES]
        rows.append([f"slides at µ = {friction:g} from [N]", *pulls, f"{friction * _NORMAL:.3f}"])
    creeps = [f"{1e6 * _creep(engine):.3g}" for engine in ENGINES]
    return [*rows, ["creeps in 10 s under half the pull, µ = 0.5 [µm]", *creeps, "0"]]


def _held(engine: str, friction: float, push: Disturbance) -> Callable[[], PlantState]:
    """Return a function that advances by a tick a block that stiff joints hold by two sides.

    Both sides press with half of `_NORMAL`, and the pull has the direction of a tangent, z.
    """
    body = ObjectConfig(mass=0.2, friction=friction)
    given = PlantConfig(layout="pinch", rate=1000.0, object=body, disturbances=[push])
    plant = make_plant(given.changed({"engine": engine}))
    start = plant.state
    tips = plant.hand.fingertips(start.theta)
    jacobian = hand_jacobian(tips, start.contacts.positions, start.contacts.rotations)
    forces = np.outer(_NORMAL * np.array([0.25, 0.25, 0.5]), [0.0, 1.0, 0.0])
    torque = jacobian.reshape(-1, plant.hand.joints).T @ forces.ravel()

    def advance() -> PlantState:
        now = plant.state
        return plant.advance(torque - 200.0 * (now.theta - start.theta) - 4.0 * now.rates)

    return advance


def _pull_at_slip(engine: str, friction: float) -> float:
    """Return the pull at which the last contact starts to slide, N.

    Joints give way, so it is scaled to `_NORMAL`, by the mean over 0.1 s: MuJoCo's forces vary.
    """
    largest = 1.5 * friction * _NORMAL
    push = Disturbance(kind="ramp", duration=largest / _RAMP, force=(0.0, 0.0, largest))
    advance = _held(engine, friction, push)
    normals: list[float] = []
    while len(normals) < 1000.0 * push.duration:
        state = advance()
        normals.append(float(state.forces[:, 1].sum()))
        if state.speeds.min() > _SLIDING:
            pull = largest * push.factor(1e-3 * len(normals))
            return pull * _NORMAL / float(np.mean(normals[-100:]))
    return float("nan")


def _creep(engine: str) -> float:
    """Return the largest distance that a contact slides in 10 s of a constant pull, m."""
    push = Disturbance(kind="ramp", duration=0.5, force=(0.0, 0.0, 0.25 * _NORMAL))
    advance = _held(engine, 0.5, push)
    slid = [advance().slid for _ in range(11_000)]
    return float((slid[-1] - slid[1000]).max())
