# SPDX-License-Identifier: Apache-2.0
"""The state of a node is the worst that is true, and it recovers."""

import pytest

from tactile_hand_ros.ros.diagnostics import ERROR, OK, STALE, WARN, WARN_SECONDS, Diagnostics


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def diagnostics(clock):
    return Diagnostics("/left/plant", clock)


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_a_running_node_reports_its_rate(diagnostics, clock):
    assert diagnostics.status().level == OK
    for _ in range(50):
        diagnostics.tick()
    clock.now += 0.5
    status = diagnostics.status()
    assert (status.name, status.level, status.message) == ("/left/plant", OK, "running")
    assert values(status)["rate_hz"] == "100.0"
    assert values(status)["ticks"] == "50"


def test_without_new_ticks_it_is_stale(diagnostics, clock):
    diagnostics.tick()
    clock.now += 1.0
    assert diagnostics.status().level == OK
    clock.now += 1.0
    assert diagnostics.status().level == STALE


def test_rejected_messages_warn_for_a_while_and_stay_counted(diagnostics, clock):
    assert diagnostics.reject("desired_pose", "position is nan")
    assert not diagnostics.reject("desired_pose", "frame_id is 'world'")
    assert diagnostics.reject("joint_command", "unknown joint")
    status = diagnostics.status()
    assert status.level == WARN
    assert "unknown joint" in status.message or "frame_id" in status.message
    assert values(status)["rejected desired_pose"] == "2"
    assert values(status)["last reason desired_pose"] == "frame_id is 'world'"
    clock.now += WARN_SECONDS
    assert diagnostics.status().level == OK
    assert diagnostics.rejected == {"desired_pose": 2, "joint_command": 1}
    assert diagnostics.reject("desired_pose", "again")


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


def test_latencies_become_percentiles(diagnostics):
    assert "latency_p50_us" not in values(diagnostics.status())
    for index in range(10_001):
        diagnostics.latency(index * 1e-6)
    shown = values(diagnostics.status())
    assert 7500 < float(shown["latency_p50_us"]) < 8500
    assert float(shown["latency_max_us"]) == 10_000


def test_values_are_texts(diagnostics):
    diagnostics.value("residual", 1.23456789e-10)
    diagnostics.value("solver", "solved")
    shown = values(diagnostics.status())
    assert shown["residual"] == "1.23457e-10"
    assert shown["solver"] == "solved"
