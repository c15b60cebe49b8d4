# SPDX-License-Identifier: Apache-2.0
"""Work that can wait is done after a tick, one piece at a time, and at once when no ticks come."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from tactile_hand_ros.ros.realtime.between_ticks import BetweenTicks
from tactile_hand_ros.ros.realtime.causes import DIAGNOSTICS, RECORDER


class Process:
    """A queue with a clock that is set by hand, and two pieces of work."""

    def __init__(self) -> None:
        self.now = 100.0
        self.done: list[str] = []
        self.queue = BetweenTicks(lambda: self.now)

    def first(self) -> None:
        self.now += 0.001
        self.done.append("first")

    def second(self) -> None:
        self.done.append("second")


@pytest.fixture
def process() -> Iterator[Process]:
    """A process that runs in real time; the collector is as before afterwards."""
    made = Process()
    made.queue.begin()
    yield made
    gc.unfreeze()
    gc.enable()


def test_without_real_time_nothing_waits() -> None:
    process = Process()
    process.queue.tick_done()
    process.queue.run(process.first)
    assert process.done == ["first"]


def test_work_waits_for_the_end_of_a_tick_and_is_done_one_by_one(process: Process) -> None:
    process.queue.tick_done()
    process.queue.run(process.first)
    process.queue.run(process.second)
    process.queue.run(process.first)  # waits already
    assert process.done == []
    process.queue.tick_done()
    assert process.done == ["first"]
    process.queue.tick_done()
    process.queue.tick_done()
    assert process.done == ["first", "second"]
    assert process.queue.spent[DIAGNOSTICS] == pytest.approx(0.001)
    with process.queue.recording():
        process.now += 0.5
    assert process.queue.spent[RECORDER] == pytest.approx(0.5)


def test_when_the_ticks_stop_nothing_waits_any_more(process: Process) -> None:
    process.queue.tick_done()
    process.queue.run(process.first)
    process.now += 1.0
    process.queue.run(process.second)
    assert process.done == ["second"]
    process.queue.rest()
    assert process.done == ["second", "first"]
    process.queue.run(process.second)
    assert process.done[-1] == "second"


def test_the_plant_alone_ends_the_ticks_of_its_process(process: Process) -> None:
    process.queue.tick_done(by_plant=True)
    process.queue.run(process.first)
    process.queue.tick_done()
    assert process.done == []
    process.queue.tick_done(by_plant=True)
    assert process.done == ["first"]


def test_work_that_fails_is_not_done_again(process: Process) -> None:
    def fail() -> None:
        raise ValueError

    process.queue.tick_done()
    process.queue.run(fail)
    with pytest.raises(ValueError):
        process.queue.tick_done()
    process.queue.tick_done()
