# SPDX-License-Identifier: Apache-2.0
"""The plant beside SciPy's RK45 on the paper's differential equations (2) to (6)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bench.baselines.reference import Reference, State, World
from bench.result import Result
from bench.workload import Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.simulation.plant import Plant

Array = NDArray[np.float64]

_TICKS = 300
_RTOL, _ATOL = 1e-6, 1e-9
_NEAR = 1e-4  # m; how far the two may drift apart over `_TICKS`


def reference_of(plant: Plant) -> tuple[Reference, Array]:
    """Return the equations of a plant whose fingers all stick, and its state as a vector."""
    config, hand, state = plant.config, plant.hand, plant.state
    inward = state.contacts.rotations[:, :, 1]
    world = World(
        urdf=hand.description,
        tips=[finger.tip for finger in load_hand_config(config.hand).fingers],
        radii=hand.radii,
        mass=config.object.mass,
        inertia=np.diag(config.object.inertia),
        gravity=np.array(config.gravity),
        faces=-inward @ state.rotation,
    )
    quaternion = Rotation.from_matrix(state.rotation).as_quat()
    now = State(state.theta, state.rates, state.position, quaternion, state.velocity, state.spin)
    return Reference(world), now.pack()


def measure_integrator(work: Workload) -> list[Result]:
    """Move hand and object by the commands of a run, in turns with RK45."""
    plant = ClosedLoop(work.scenario).plant
    reference, y = reference_of(plant)
    tick, steps = 1e-9 * work.scenario.plant.tick, work.scenario.plant.steps_per_tick
    ours, theirs, apart = [], [], []
    for torque in work.record.command[:_TICKS]:
        began = time.perf_counter()
        state = plant.advance(torque)
        between = time.perf_counter()
        y = _advanced(reference, y, torque, tick)
        theirs.append(1e6 * (time.perf_counter() - between) / steps)
        ours.append(1e6 * (between - began) / steps)
        apart.append(float(np.linalg.norm(reference.unpack(y).position - state.position)))
    return [
        Result("SciPy's RK45, over a step of the plant", "x", np.divide(theirs, ours)),
        Result("plant, distance from RK45", "m", apart, at_most=_NEAR),
    ]


def _advanced(reference: Reference, y: Array, torque: Array, seconds: float) -> Array:
    """Integrate over a tick, the torque held."""
    still = np.zeros(6)

    def rate(_: float, now: Array) -> Array:
        return reference.solve_rates(now, torque, still)[0]

    found = solve_ivp(rate, (0.0, seconds), y, method="RK45", rtol=_RTOL, atol=_ATOL)
    return np.asarray(found.y[:, -1])
