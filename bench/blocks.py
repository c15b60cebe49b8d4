# SPDX-License-Identifier: Apache-2.0
"""Duration of the blocks and throughput of the loop, in-process."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial

from bench.result import Measurement
from bench.workload import Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.hand.joints import Joints


def _times(calls: Iterator[Callable[[], object]]) -> list[float]:
    """Return the duration of each call [us]."""
    found = []
    for call in calls:
        began = time.perf_counter()
        call()
        found.append(1e6 * (time.perf_counter() - began))
    return found


def measure_blocks(work: Workload) -> list[Measurement]:
    """Measure (13), the controller and the plant with the inputs of a run, called as in nodes."""
    loop, record = ClosedLoop(work.scenario), work.record
    solves = (lambda c=contacts: loop.optimizer.solve(c) for contacts in work.grasps)
    answers = (
        lambda i=i, contacts=contacts: loop.controller.step(
            int(record.stamps[i]),
            Joints(record.theta[i], record.rates[i]),
            contacts,
            record.optimal_forces[i],
            float(record.grasp_force[i]),
        )
        for i, contacts in enumerate(work.grasps)
    )
    steps = (lambda torque=torque: loop.plant.advance(torque) for torque in record.command)
    return [
        Measurement("(13), exact, with checks", "us", _times(solves), maximum=15.0),
        Measurement("controller, one tick", "us", _times(answers)),
        Measurement("plant, one tick of 2 ms", "us", _times(steps), maximum=120.0),
    ]


def measure_loop(work: Workload) -> list[Measurement]:
    """Measure the whole loop in-process, as the reference for all other rates."""
    single = work.scenario.changed({"plant.rate": 1.0 / work.scenario.plant.time_step})
    ticks = len(work.record)
    spent = _times(partial(ClosedLoop(single).run, ticks) for _ in range(work.repeats))
    rates = [1e6 * ticks / each for each in spent]
    return [Measurement("in-process, one plant step a tick", "ticks/s", rates)]
