# SPDX-License-Identifier: Apache-2.0
"""RK45 solves the same motion as the plant, or comparing their speed would mean nothing."""

from __future__ import annotations

from bench.baselines.integrator import measure_integrator
from bench.workload import Workload


def test_the_plant_and_rk45_move_alike_and_are_timed_in_turns() -> None:
    theirs, ours, apart = measure_integrator(Workload.prepare(ticks=40, repeats=1))
    assert theirs.beside == ours.name and theirs.count == ours.count == 40
    assert 0.0 < apart.largest < 1e-4 and apart.met
