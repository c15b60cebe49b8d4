# SPDX-License-Identifier: Apache-2.0
"""What recording and recomputing are measured to cost."""

from __future__ import annotations

from bench.recording import measure_recompute, measure_recorder
from bench.workload import Workload


def test_recorder_is_measured_over_processes() -> None:
    """All that was offered is in the bag, at some cost."""
    offered, share, lost = measure_recorder(Workload.prepare(2, 1), 0.5)
    assert offered.median > 0.0 and share.median > 0.0
    assert lost.largest == 0.0 and lost.met


def test_recomputation_is_measured() -> None:
    """Its goal is to be faster than real time by far; whether it is met, the bench says."""
    [speed] = measure_recompute(Workload.prepare(50, 2))
    assert speed.median > 0.0 and speed.count == 2 and speed.met is not None
