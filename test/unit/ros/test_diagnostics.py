# SPDX-License-Identifier: Apache-2.0
"""A node reports its worst present state, and recovers."""

from types import SimpleNamespace

import pytest

from tactile_hand_ros.ros.diagnostics import (
    ERROR,
    OK,
    STALE,
    WARN,
    WARN_SECONDS,
    Diagnostics,
    Mostly,
)


@pytest.fixture
def clock():
    return SimpleNamespace(now=100.0)


@pytest.fixture
def diagnostics(clock):
    return Diagnostics("/left/plant", lambda: clock.now)


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_a_fault_is_worst_until_it_is_cleared(diagnostics):
    diagnostics.reject("x", "bad")
    diagnostics.fault("margin", "A7 is near its limit", WARN)
    diagnostics.fault("solver", "no solution")
    status = diagnostics.status()
    assert (status.level, status.message) == (ERROR, "no solution")
    assert values(status)["fault margin"] == "A7 is near its limit"
    diagnostics.clear("solver")
    assert diagnostics.status().message == "A7 is near its limit"
    diagnostics.clear("margin")
    diagnostics.clear("margin")
    assert "rejected" in diagnostics.status().message


def test_the_rate_is_that_since_the_last_status(diagnostics, clock):
    for ticks, rate in ((30, "60.0"), (10, "20.0")):
        for _ in range(ticks):
            diagnostics.tick()
        clock.now += 0.5
        assert values(diagnostics.status())["rate_hz"] == rate
    diagnostics.tick()
    assert values(diagnostics.status())["rate_hz"] == "0.0"  # no time has passed
    clock.now += 1.0
    assert diagnostics.status().message == "no new tick, 41 so far"


def test_silence_is_named_also_before_the_first_tick_and_beside_an_old_warning(diagnostics, clock):
    assert diagnostics.status().message == "running"
    diagnostics.expects = "joint_states"
    assert diagnostics.status().level == STALE
    assert "no joint_states" in diagnostics.status().message
    diagnostics.tick()
    diagnostics.fault("margin", "small", WARN)
    assert diagnostics.status().message == "small"
    assert diagnostics.status().message == "small; no new tick, 1 so far"
    diagnostics.clear("margin")
    assert diagnostics.status().message == "no new tick, 1 so far"


def test_an_error_outlasts_rejections_and_warnings_but_not_a_fault(diagnostics, clock):
    assert diagnostics.error("/timer", "ValueError")
    assert not diagnostics.error("/timer", "KeyError")
    diagnostics.reject("pose", "bad")
    diagnostics.fault("margin", "small", WARN)
    status = diagnostics.status()
    assert (status.level, status.message) == (ERROR, "2 errors in /timer: KeyError")
    assert values(status)["errors /timer"] == "2"
    assert values(status)["last error /timer"] == "KeyError"
    diagnostics.judge("solver", True, "no solution")
    assert diagnostics.status().message == "no solution"
    diagnostics.judge("solver", False, "no solution")
    clock.now += WARN_SECONDS
    status = diagnostics.status()
    assert (status.level, status.message) == (WARN, "small")


def test_the_newest_is_told_until_its_time_is_over(diagnostics, clock):
    diagnostics.reject("old", "first")
    clock.now += 1.0
    diagnostics.reject("new", "second")
    assert diagnostics.status().message == "1 message on new rejected: second"
    diagnostics.reject("old", 1000 * "x")
    assert len(diagnostics.status().message) < 400
    clock.now += 0.5
    diagnostics.reject("old", "fourth")
    assert diagnostics.status().message == "3 messages on old rejected: fourth"
    clock.now += 4.75
    assert diagnostics.status().level == WARN
    clock.now += 0.25
    assert diagnostics.status().level == OK


def test_the_same_is_logged_again_five_seconds_after_it_was_logged(diagnostics, clock):
    logged = []
    for _ in range(12):
        logged.append(diagnostics.reject("pose", "bad"))
        clock.now += 1.0
    assert logged == [True, *4 * [False], True, *4 * [False], True, False]


def test_percentiles_are_of_the_last_4096_latencies(diagnostics):
    diagnostics.latency(9.0)
    diagnostics.latency(0.0)
    for _ in range(4094):
        diagnostics.latency(0.0)
    assert values(diagnostics.status())["latency_max_us"] == "9000000"
    diagnostics.latency(1e-6)
    assert values(diagnostics.status())["latency_max_us"] == "1"


def test_most_of_the_ticks_since_the_last_question_decide():
    mostly = Mostly()
    assert not mostly()
    for noted, answer in (
        ([True], True),
        ([], True),  # as before
        ([True, False], False),  # half is not most
        ([True, False, True], True),
        ([False, False, True], False),
        ([], False),
    ):
        for holds in noted:
            mostly.note(holds)
        assert mostly() == answer
