# SPDX-License-Identifier: Apache-2.0
"""The largest part of a late tick's time is its cause, and real causes are recognised."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from tactile_hand_ros.ros.realtime import causes
from tactile_hand_ros.ros.realtime.causes import Counters, TickWatch, delays, parts
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
watch = TickWatch({}, 0.01)
watch.begin(0.0)
end = time.monotonic() + 0.3
while time.monotonic() < end:
    pass
print(watch.cause(awaits_others=False), end="")
os.kill(rival, 9)
"""
NONE = Counters(0.0, 0.0, 0.0, 0, 0, {causes.GARBAGE: 0.0, causes.DIAGNOSTICS: 0.0})


def counted(**after: object) -> Counters:
    """Return the counters 4 ms later."""
    timed = {**NONE.timed, **after.pop("timed", {})}  # type: ignore[dict-item]
    return replace(NONE, at=0.004, timed=timed, **after)  # type: ignore[arg-type]


def largest(found: dict[str, float]) -> str:
    """Return the cause that took longest."""
    return max(found, key=lambda cause: found[cause])


@pytest.mark.parametrize(
    ("after", "cause"),
    [
        ({"cpu": 0.003}, causes.COMPUTING),
        ({"cpu": 0.001, "delay": 0.003}, causes.PREEMPTION),
        ({"cpu": 0.001}, "idle"),
        ({"cpu": 0.001, "major": 1}, causes.PAGE_FAULT),
        ({"cpu": 0.003, "minor": 2000}, causes.PAGE_FAULT),
        ({"cpu": 0.003, "timed": {causes.GARBAGE: 0.002}}, causes.GARBAGE),
        ({"cpu": 0.004, "timed": {causes.DIAGNOSTICS: 0.003}}, causes.DIAGNOSTICS),
    ],
)
def test_time_is_split_into_parts_that_add_up(after: dict[str, object], cause: str) -> None:
    found = parts(NONE, counted(**after))
    assert largest(found) == cause
    assert sum(found.values()) == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("after", "behind", "cause"),
    [
        ({"cpu": 0.001, "timed": {causes.DIAGNOSTICS: 0.001}}, 0.0005, causes.DIAGNOSTICS),
        ({"delay": 0.002}, 0.002, causes.PREEMPTION),
        ({}, 0.002, causes.UNKNOWN),
        ({"cpu": 0.001}, 0.009, causes.GARBAGE),  # the tick before it was that late
    ],
)
def test_what_made_a_tick_begin_late(after: dict[str, object], behind: float, cause: str) -> None:
    found = delays(NONE, counted(**after), behind, causes.GARBAGE)
    assert largest(found) == cause
    assert sum(found.values()) == pytest.approx(behind)


@pytest.fixture
def collections() -> Iterator[CollectionClock]:
    """The time of collections."""
    clock = CollectionClock()
    yield clock
    clock.close()


@pytest.fixture
def watch(collections: CollectionClock) -> Iterator[TickWatch]:
    """A watch over ticks of 10 ms."""
    made = TickWatch({causes.GARBAGE: lambda: collections.seconds}, 0.01)
    yield made
    made.close()


def compute(seconds: float) -> None:
    """Use the processor."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_what_a_thread_really_did_is_recognised(watch: TickWatch) -> None:
    """A machine with other work may preempt it, too."""
    watch.begin(0.0)
    compute(0.002)
    assert watch.cause(awaits_others=True) in (causes.COMPUTING, causes.PREEMPTION)
    watch.begin(0.0)
    threading.Event().wait(0.02)
    assert watch.cause(awaits_others=True) in (causes.OTHERS, causes.PREEMPTION)
    watch.begin(0.0)
    for _ in range(3):
        gc.collect()
    assert watch.cause(awaits_others=False) in (causes.GARBAGE, causes.PREEMPTION)


def test_usual_computing_is_no_cause(watch: TickWatch) -> None:
    for _ in range(3):
        watch.begin(0.0)
        compute(0.002)
        watch.end(in_time=True)
    watch.begin(0.0)
    compute(0.002)
    threading.Event().wait(0.005)
    assert watch.cause(awaits_others=True) in (causes.OTHERS, causes.PREEMPTION)


def test_what_happened_after_the_last_answer_explains_a_late_start(watch: TickWatch) -> None:
    watch.begin(0.0)
    watch.end(in_time=True)
    for _ in range(3):
        gc.collect()
    watch.begin(0.01)
    assert watch.cause_before() in (causes.GARBAGE, causes.PREEMPTION)


def test_a_thread_that_has_to_wait_for_a_processor_was_preempted() -> None:
    ran = subprocess.run([sys.executable, "-c", _RIVALS], capture_output=True, text=True)
    assert ran.stdout == causes.PREEMPTION, ran.stderr
