# SPDX-License-Identifier: Apache-2.0
"""How the time of a late tick is shared out between its causes, to the number."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from tactile_hand_ros.ros.realtime import causes
from tactile_hand_ros.ros.realtime.causes import Counters, TickWatch, delays, parts

A, B = causes.GARBAGE, causes.RECORDER


def counters(at: float, **changes: Any) -> Counters:
    values: dict[str, Any] = {"cpu": 0.0, "delay": 0.0, "major": 0, "minor": 0}
    values["timed"] = {A: 0.0, B: 0.0}
    return Counters(at, **{**values, **changes})


BEFORE = counters(10.0, cpu=1.0, delay=2.0, major=3, minor=400, timed={A: 0.5, B: 0.25})
AFTER = counters(10.5, cpu=1.25, delay=2.0625, major=3, minor=1400, timed={A: 0.53125, B: 0.375})


def test_parts_of_a_time_add_up_to_it() -> None:
    found = parts(BEFORE, AFTER)
    assert found == pytest.approx(
        {
            A: 0.03125,
            B: 0.125,
            causes.PREEMPTION: 0.0625,
            causes.PAGE_FAULT: 0.001,
            causes.COMPUTING: 0.25 - 0.03125 - 0.125 - 0.001,
            "idle": 0.5 - 0.25 - 0.0625,
        }
    )


def test_idle_time_with_a_fault_that_reads_from_a_disk_is_that_of_the_disk() -> None:
    found = parts(BEFORE, Counters(**{**AFTER.__dict__, "major": 4}))
    assert found["idle"] == 0.0 and found[causes.PAGE_FAULT] == pytest.approx(0.1885)


def test_faults_take_no_more_than_was_computed_and_nothing_is_negative() -> None:
    found = parts(
        counters(0.0), counters(0.5, cpu=0.25, delay=0.5, minor=10**6, timed={A: 0.5, B: 0.0})
    )
    assert found[causes.PAGE_FAULT] == 0.25
    assert found[causes.COMPUTING] == found["idle"] == 0.0


def test_a_late_begin_is_due_to_what_happened_no_longer_than_it_was_late() -> None:
    found = delays(BEFORE, AFTER, 0.125, causes.DIAGNOSTICS)
    assert found[B] == 0.125 and found[A] == 0.03125
    assert found[causes.UNKNOWN] == found[causes.DIAGNOSTICS] == 0.0
    assert "idle" not in found


def test_what_nothing_explains_is_unknown_and_what_was_late_before_is_inherited() -> None:
    quiet = delays(counters(0.0), counters(0.5, cpu=0.0625), 0.25, A)
    assert quiet[causes.UNKNOWN] == 0.1875 and quiet[A] == 0.0
    long = delays(counters(0.0), counters(0.5, timed={A: 0.25, B: 0.0}), 0.75, A)
    assert long[A] == 0.5  # its own, and that of the tick before
    assert long[causes.UNKNOWN] == pytest.approx(0.25)


class Watch(TickWatch):
    """A watch over ticks of a second that reads its counters from a list."""

    def __init__(self) -> None:
        self.now = counters(0.0)
        super().__init__({}, 1.0)

    def _count(self) -> Counters:
        return self.now

    def tick(self, at: float, cpu: float, *, behind: float = 0.0, in_time: bool = True) -> None:
        """Answer a tick that begins at a time and takes so much of the processor."""
        used = self.now.cpu
        self.now = counters(at, cpu=used)
        self.begin(behind)
        self.now = counters(at + cpu, cpu=used + cpu)
        self.end(in_time=in_time)

    def late(self, at: float, took: float, cpu: float, *, others: bool = False) -> str:
        used = self.now.cpu
        self.now = counters(at, cpu=used)
        self.begin(0.0)
        self.now = counters(at + took, cpu=used + cpu)
        return self.cause(awaits_others=others)


@pytest.fixture
def watch() -> Iterator[Watch]:
    made = Watch()
    yield made
    made.close()


def test_what_is_usual_is_the_first_tick_and_then_follows_slowly(watch: Watch) -> None:
    watch.tick(1.0, 0.4)
    assert watch._typical == pytest.approx(0.4)
    watch.tick(2.0, 0.6)
    assert watch._typical == pytest.approx(0.41)
    watch.tick(3.0, 0.8, in_time=False)
    assert watch._typical == pytest.approx(0.41)


@pytest.mark.parametrize(
    ("usual", "cpu", "others", "cause"),
    [
        (0.0, 0.6, False, causes.COMPUTING),
        (0.5, 0.6, False, causes.UNKNOWN),  # 0.1 more than usual, and 0.4 idle
        (0.5, 0.6, True, causes.OTHERS),
        (0.5, 0.96, False, causes.COMPUTING),
        (0.69, 0.6, False, causes.UNKNOWN),
        (0.7, 0.6, False, causes.COMPUTING),  # the usual alone is too much
    ],
)
def test_only_unusual_computing_is_a_cause(
    watch: Watch, usual: float, cpu: float, others: bool, cause: str
) -> None:
    watch.tick(1.0, usual)
    assert watch.late(2.0, 1.0, cpu, others=others) == cause


def test_what_delayed_the_begin_counts_and_goes_on(watch: Watch) -> None:
    watch.tick(1.0, 0.25)
    watch.now = counters(2.0, cpu=0.25, delay=0.5)
    watch.begin(0.5)
    assert watch.cause_before() == causes.PREEMPTION
    watch.now = counters(2.125, cpu=0.25, delay=0.5)
    assert watch.cause(awaits_others=True) == causes.PREEMPTION
    watch.now = counters(2.25, cpu=0.25, delay=0.5)
    watch.begin(0.25)  # the one before is not answered: it was judged already
    assert watch.cause_before() == causes.UNKNOWN


def test_a_begin_in_time_was_not_delayed(watch: Watch) -> None:
    watch.tick(1.0, 0.25)
    watch.now = counters(2.0, cpu=0.25, delay=0.5)
    watch.begin(0.0)
    assert watch.cause_before() == causes.UNKNOWN


def test_the_delay_is_that_of_the_kernel_until_it_is_closed(tmp_path: Any) -> None:
    made = TickWatch({}, 1.0)
    file = tmp_path / "schedstat"
    file.write_text("1000 2500000000 7\n")
    with file.open("rb") as stat:
        kernels, made._schedstat = made._schedstat, stat.fileno()
        assert made._count().delay == 2.5
        made._schedstat = kernels
    assert kernels is not None and made._count().delay >= 0.0
    made.close()
    made.close()
    with pytest.raises(OSError):
        os.fstat(kernels)
    assert made._count().delay == 0.0


def test_the_figures_of_a_thread_that_has_ended_are_none() -> None:
    made: list[TickWatch] = []
    thread = threading.Thread(target=lambda: made.append(TickWatch({}, 1.0)))
    thread.start()
    thread.join()
    assert made[0]._count().delay >= 0.0
    made[0].close()
