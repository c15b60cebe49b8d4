# SPDX-License-Identifier: Apache-2.0
"""Measurements of speed: functions, each of which gives one or more results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from bench.baselines.integrator import measure_integrator
from bench.baselines.libraries import measure_solvers, measure_steps
from bench.blocks import (
    measure_closed_loop,
    measure_controller,
    measure_optimizer,
    measure_plant,
)
from bench.graph import measure_graph, measure_idle
from bench.hops import measure_hops
from bench.realtime.cases import measure_realtime
from bench.recording import measure_recompute, measure_recorder
from bench.results import Result
from bench.wire import measure_wire
from bench.workload import Workload

Measurement = Callable[[Workload], list[Result]]

SECTIONS: dict[str, tuple[Measurement, ...]] = {
    "function calls": (
        measure_optimizer,
        measure_controller,
        measure_plant,
        measure_closed_loop,
    ),
    "other libraries": (measure_solvers, measure_steps, measure_integrator),
    "messages": (measure_hops, measure_wire),
    "nodes": (measure_idle, measure_graph),
    "real time": (measure_realtime,),
    "recordings": (measure_recorder, measure_recompute),
}
"""All measurements by section, in the order of the page."""

BLOCKS = SECTIONS["function calls"]
"""Those that need no processes and no other libraries."""

MEASUREMENTS: tuple[Measurement, ...] = tuple(chain.from_iterable(SECTIONS.values()))


def section_of(measurement: Measurement) -> str:
    """Return the title of the section that a measurement belongs to."""
    return next(title for title, some in SECTIONS.items() if measurement in some)


def run_measurements(
    work: Workload, measurements: Sequence[Measurement] = MEASUREMENTS
) -> Iterator[Result]:
    """Take measurements, one after the other so that they do not disturb each other."""
    for measurement in measurements:
        for result in measurement(work):
            yield replace(result, section=section_of(measurement))
