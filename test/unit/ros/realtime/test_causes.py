# SPDX-License-Identifier: Apache-2.0
"""The largest part of a late tick's time is its cause, and real causes are recognised."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from tactile_hand_ros.ros.realtime import causes
from tactile_hand_ros.ros.realtime.causes import Counters, TickWatch, largest
from tactile_hand_ros.ros.realtime.garbage import CollectionClock

# Two processes share one processor, and the one that is watched hardly gets any of it.
_RIVALS = """
import os, time
from tactile_hand_ros.ros.realtime.causes import TickWatch
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
rival = os.fork()
while not rival:
    pass
os.nice(10)
watch = TickWatch({})
end = time.monotonic() + 0.3
while time.monotonic() < end:
    pass
print(watch.cause(awaits_others=False), end="")
os.kill(rival, 9)
"""
NONE = Counters(0.0, 0.0, 0.0, 0, 0, {causes.GARBAGE: 0.0, causes.DIAGNOSTICS: 0.0})


@pytest.mark.parametrize(
    ("after", "others", "cause"),
    [
        ({"cpu": 0.003}, False, causes.COMPUTING),
        ({"cpu": 0.001, "delay": 0.003}, False, causes.PREEMPTION),
        ({"cpu": 0.001}, True, causes.OTHERS),
        ({"cpu": 0.001}, False, causes.UNKNOWN),
        ({"cpu": 0.001, "major": 1}, True, causes.PAGE_FAULT),
        ({"cpu": 0.003, "minor": 2000}, False, causes.PAGE_FAULT),
        ({"cpu": 0.003, "timed": {causes.GARBAGE: 0.002}}, False, causes.GARBAGE),
        ({"cpu": 0.004, "timed": {causes.DIAGNOSTICS: 0.003}}, False, causes.DIAGNOSTICS),
    ],
)
def test_the_largest_part_is_the_cause(after: dict[str, object], others: bool, cause: str) -> None:
    counted = {**after, "timed": {**NONE.timed, **after.get("timed", {})}}  # type: ignore[dict-item]
    counters = replace(NONE, at=0.004, **counted)  # type: ignore[arg-type]
    assert largest(NONE, counters, awaits_others=others) == cause


def test_what_a_thread_really_did_is_recognised() -> None:
    clock = CollectionClock()
    watch = TickWatch({causes.GARBAGE: lambda: clock.seconds})
    try:
        watch.begin()
        end = time.thread_time() + 0.002
        while time.thread_time() < end:
            pass
        assert watch.cause(awaits_others=True) in (causes.COMPUTING, causes.PREEMPTION)
        watch.begin()
        threading.Event().wait(0.02)
        assert watch.cause(awaits_others=True) in (causes.OTHERS, causes.PREEMPTION)
        watch.begin()
        for _ in range(3):
            gc.collect()
        assert watch.cause(awaits_others=False) in (causes.GARBAGE, causes.PREEMPTION)
    finally:
        watch.close()
        clock.close()


def test_a_thread_that_has_to_wait_for_a_processor_was_preempted() -> None:
    ran = subprocess.run([sys.executable, "-c", _RIVALS], capture_output=True, text=True)
    assert ran.stdout == causes.PREEMPTION, ran.stderr
