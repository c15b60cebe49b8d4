# SPDX-License-Identifier: Apache-2.0
"""Measurements of speed: functions, each of which gives one or more results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from tactile_hand_ros.bench.blocks import (
    measure_closed_loop,
    measure_controller,
    measure_optimizer,
    measure_plant,
)
from tactile_hand_ros.bench.graph import measure_graph, measure_idle
from tactile_hand_ros.bench.hops import measure_hops
from tactile_hand_ros.bench.peers.integrator import measure_integrator
from tactile_hand_ros.bench.peers.libraries import measure_solvers, measure_steps
from tactile_hand_ros.bench.realtime import measure_realtime
from tactile_hand_ros.bench.recording import measure_recompute, measure_recorder
from tactile_hand_ros.bench.results import Result
from tactile_hand_ros.bench.wire import measure_wire
from tactile_hand_ros.bench.workload import Workload

Measurement = Callable[[Workload], list[Result]]

BLOCKS: tuple[Measurement, ...] = (
    measure_optimizer,
    measure_controller,
    measure_plant,
    measure_closed_loop,
)
"""Function calls only."""

MEASUREMENTS: tuple[Measurement, ...] = (
    *BLOCKS,
    measure_solvers,
    measure_steps,
    measure_integrator,
    measure_hops,
    measure_wire,
    measure_idle,
    measure_graph,
    measure_realtime,
    measure_recorder,
    measure_recompute,
)
"""All measurements, in the order of the table."""


def run_measurements(
    work: Workload, measurements: Sequence[Measurement] = MEASUREMENTS
) -> Iterator[Result]:
    """Take measurements, one after the other so that they do not disturb each other."""
    for measurement in measurements:
        yield from measurement(work)
