# SPDX-License-Identifier: Apache-2.0
"""The same work done by other libraries, turn by turn with ours."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bench.result import Measurement
from bench.workload import Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import centered, grasp_map

Array = NDArray[np.float64]
Problem = tuple[Array, Array, Array]
"""Diagonal of W, rows of the equalities, their right sides."""

_AGREE = 1e-4
"""Largest difference from our answer that counts as the same."""


def problem(contacts: Contacts, weights: Array) -> Problem:
    """Write (13) down for any solver: min f^T W f, A f = b, normal forces not negative."""
    count = len(contacts.positions)
    rows = np.zeros((7, 3 * count))
    rows[:6] = grasp_map(centered(contacts.positions), contacts.rotations)
    rows[6, 1::3] = 1.0
    return weights, rows, np.array([0.0] * 6 + [1.0])


def _by_qpsolvers(name: str) -> Callable[[Array, Array, Array], Array]:
    qpsolvers: Any = importlib.import_module("qpsolvers")
    if name not in qpsolvers.available_solvers:
        raise ModuleNotFoundError(name)
    options = {"eps_abs": 1e-6, "eps_rel": 1e-6, "polishing": True} if name == "osqp" else {}
    shape = sparse.csc_matrix if name == "osqp" else np.asarray

    def solve(weights: Array, rows: Array, right: Array) -> Array:
        n = len(weights)
        lower = np.full(n, -np.inf)
        lower[1::3] = 0.0
        found: Array = qpsolvers.solve_qp(
            shape(np.diag(2.0 * weights)),
            np.zeros(n),
            A=shape(rows),
            b=right,
            lb=lower,
            solver=name,
            **options,
        )
        return found

    return solve


def _solvers() -> dict[str, Callable[[Array, Array, Array], Array]]:
    """Return the solvers that are installed."""
    found = {}
    for label, name in (("OSQP by qpsolvers", "osqp"), ("quadprog", "quadprog"), ("DAQP", "daqp")):
        try:
            found[label] = _by_qpsolvers(name)
        except ModuleNotFoundError:
            continue
    return found


def measure_solvers(work: Workload) -> list[Measurement]:
    """Solve (13) for the same contacts with other solvers; who answers otherwise is left out."""
    optimizer = ClosedLoop(work.scenario).optimizer
    grasps = work.grasps[:: max(1, len(work.record) // 1000)]
    weights = work.scenario.force_optimizer.weight_vector(len(grasps[0].positions))
    solvers = _solvers()
    times: dict[str, list[float]] = {name: [] for name in ("(13), ours", *solvers)}
    apart = dict.fromkeys(solvers, 0.0)
    for contacts in grasps:
        began = time.perf_counter()
        ours = optimizer.solve(contacts)
        times["(13), ours"].append(1e6 * (time.perf_counter() - began))
        for name, solve in solvers.items():
            began = time.perf_counter()
            theirs = solve(*problem(contacts, weights))
            times[name].append(1e6 * (time.perf_counter() - began))
            apart[name] = max(apart[name], float(np.abs(theirs - ours.forces.ravel()).max()))
    return [
        Measurement(f"(13), {name}, over ours", "x", np.divide(times[name], times["(13), ours"]))
        for name in solvers
        if apart[name] < _AGREE
    ]


def measure_steps(work: Workload) -> list[Measurement]:
    """Step MuJoCo's model of the same hand and box under the same torques, in turns with ours."""
    try:
        from bench.mujoco_model import MujocoPlant
    except ModuleNotFoundError:
        return []
    plant = ClosedLoop(work.scenario).plant
    per_tick = work.scenario.plant.steps_per_tick
    peer = MujocoPlant(work.scenario)
    ours, theirs = [], []
    for torque in work.record.command:
        began = time.perf_counter()
        plant.advance(torque)
        between = time.perf_counter()
        peer.advance(torque, per_tick)
        ours.append(1e6 * (between - began) / per_tick)
        theirs.append(1e6 * (time.perf_counter() - between) / per_tick)
        if peer.contacts < plant.hand.fingers:
            break
    return [
        Measurement("plant, one step, over MuJoCo's", "x", np.divide(ours, theirs), maximum=5.0)
    ]
