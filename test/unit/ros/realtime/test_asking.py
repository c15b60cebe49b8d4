# SPDX-License-Identifier: Apache-2.0
"""What a process asks of the kernel: for all of its threads, and a refusal is kept and told."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.context import Context

from tactile_hand_ros.ros.diagnostics import OK, WARN, Diagnostics
from tactile_hand_ros.ros.realtime import scheduling
from tactile_hand_ros.ros.realtime.between_ticks import between_ticks
from tactile_hand_ros.ros.realtime.scheduling import (
    Scheduling,
    parse_cpus,
    parse_priority,
    report_scheduling,
    take_scheduling,
    use_batch_scheduling,
)

THREADS = {int(name) for name in os.listdir("/proc/self/task")}


@pytest.fixture(autouse=True)
def unchanged() -> Iterator[None]:
    """Leave nothing behind that was asked for or refused."""
    yield
    scheduling._refusals.clear()
    scheduling._unlocked.clear()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the kernel is asked for, which a test must not be granted."""
    calls: list[tuple[Any, ...]] = []
    kernel = scheduling.os
    monkeypatch.setattr(
        kernel,
        "sched_setscheduler",
        lambda thread, policy, param: calls.append((thread, policy, param.sched_priority)),
    )
    monkeypatch.setattr(
        kernel, "sched_setaffinity", lambda thread, cpus: calls.append((thread, tuple(cpus)))
    )
    monkeypatch.setattr(scheduling, "_threads", lambda: [11, 12])
    return calls


def reported() -> tuple[bytes, str, dict[str, str]]:
    diagnostics = Diagnostics("node")
    report_scheduling(diagnostics)
    status = diagnostics.status()
    return status.level, status.message, {pair.key: pair.value for pair in status.values}


def test_every_thread_gets_the_policy_and_the_processors(asked: list[tuple[Any, ...]]) -> None:
    Scheduling(7, (0, 2)).apply()
    assert asked == [
        (11, os.SCHED_FIFO, 7),
        (12, os.SCHED_FIFO, 7),
        (11, (0, 2)),
        (12, (0, 2)),
    ]
    asked.clear()
    Scheduling().apply()
    assert asked == []


def test_the_threads_are_those_of_this_process() -> None:
    assert os.getpid() in scheduling._threads() and set(scheduling._threads()) & THREADS


@pytest.mark.parametrize(("policy", "changes"), [("SCHED_OTHER", True), ("SCHED_FIFO", False)])
def test_batch_is_asked_for_only_where_nothing_else_was(
    asked: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, policy: str, changes: bool
) -> None:
    monkeypatch.setattr(scheduling.os, "sched_getscheduler", lambda _: getattr(os, policy))
    use_batch_scheduling()
    assert asked == ([(11, os.SCHED_BATCH, 0), (12, os.SCHED_BATCH, 0)] if changes else [])


def test_what_is_in_force_is_reported() -> None:
    level, _, facts = reported()
    assert level == OK and "memory_locked" not in facts
    assert parse_cpus(facts["scheduling_cpus"]) == tuple(sorted(os.sched_getaffinity(0)))
    assert facts["scheduling_policy"].startswith("SCHED_")
    assert facts["scheduling_priority"] == str(os.sched_getparam(0).sched_priority)


def test_a_policy_without_a_name_is_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduling.os, "sched_getscheduler", lambda _: 77)
    assert reported()[2]["scheduling_policy"] == "77"


def test_each_refusal_is_told_with_advice_until_the_next_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(scheduling.os, "sched_setscheduler", refuse)
    monkeypatch.setattr(scheduling.os, "sched_getaffinity", lambda _: {2, 0, 1})
    Scheduling(5, (100_000_000_000,)).apply()
    level, message, _ = reported()
    first, second = message.split("; ")
    assert level == WARN
    assert first.startswith("--priority 5 was refused (Operation not permitted): run as root")
    assert second.startswith("--cpus 100000000000 was refused (")
    assert second.endswith("this process runs on 0,1,2")
    Scheduling().apply()
    assert reported()[0] == OK


@pytest.mark.parametrize(("refusal", "told"), [("", "yes"), ("too low", "no (too low)")])
def test_real_time_is_prepared_for_where_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, refusal: str, told: str
) -> None:
    done: list[str] = []
    context = Context()
    monkeypatch.setattr(scheduling, "lock_memory", lambda: refusal)
    for name in ("keep_heap", "touch_stack"):
        monkeypatch.setattr(scheduling, name, lambda name=name: done.append(name))
    monkeypatch.setattr(between_ticks(context), "begin", lambda: done.append("begin"))
    Scheduling(real_time=True).prepare(context)
    assert done == ["keep_heap", "touch_stack", "begin"]
    assert reported()[2]["memory_locked"] == told
    Scheduling().prepare(context)
    assert len(done) == 3 and "memory_locked" not in reported()[2]


def test_limits_of_what_may_be_asked_for() -> None:
    assert (parse_priority("0"), parse_priority("1"), parse_priority("99")) == (0, 1, 99)
    assert parse_cpus("2-2") == (2,) and parse_cpus("5,0-2") == (0, 1, 2, 5)
    assert take_scheduling(["--realtime", "--cpus=0", "x"]) == (
        Scheduling(0, (0,), real_time=True),
        ["x"],
    )
    assert Scheduling(3, (1,), real_time=True).arguments == [
        *("--priority", "3"),
        *("--cpus", "1"),
        "--realtime",
    ]
