# SPDX-License-Identifier: Apache-2.0
"""A node runs as it was asked to run where the system permits it, and says so where not."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from support.spinning import spinning

from bench.processes import CapturedProcess
from tactile_hand_ros import names
from tactile_hand_ros.ros.processes import executable_path, wait_until

PRIORITY = 7
NODE = "force_optimizer"

# Becomes another program that may not use SCHED_FIFO, whoever starts it.
_WITHOUT_RIGHT = """
import ctypes, os, resource, sys
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23
ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE)
os.execv(sys.argv[1], sys.argv[1:])
"""
_TRY = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"


@pytest.fixture
def reports(context: Context) -> Iterator[list[DiagnosticStatus]]:
    """What the node says of itself."""
    heard: list[DiagnosticStatus] = []
    node = rclpy.create_node("listener", context=context)
    node.create_subscription(
        DiagnosticArray, names.DIAGNOSTICS, lambda m: heard.extend(m.status), 10
    )
    with spinning(node):
        yield heard
    node.destroy_node()


def start(*words: str, permitted: bool = True) -> CapturedProcess:
    """Start a node, on wish without the right to use SCHED_FIFO."""
    command = [str(executable_path(NODE)), *words]
    wrapper = [] if permitted else [sys.executable, "-c", _WITHOUT_RIGHT]
    return CapturedProcess([*wrapper, *command])


def first(reports: list[DiagnosticStatus]) -> tuple[DiagnosticStatus, dict[str, str]]:
    """Wait for a report; return it and its facts."""
    status = wait_until(lambda: reports and reports[-1], 30.0, "diagnostics")
    return status, {pair.key: pair.value for pair in status.values}


def threads(pid: int) -> list[int]:
    """Return the threads of a process; there are several, of the middleware."""
    found = [int(path.name) for path in Path(f"/proc/{pid}/task").iterdir()]
    assert len(found) > 1
    return found


@pytest.mark.parametrize("permitted", [True, False])
def test_fifo_where_it_is_permitted_and_a_warning_where_not(reports, permitted):
    tried = subprocess.run([sys.executable, "-c", _TRY], capture_output=True)
    with start("--priority", str(PRIORITY), permitted=permitted) as process:
        status, facts = first(reports)
        policies = {os.sched_getscheduler(thread) for thread in threads(process.pid)}
        if permitted and tried.returncode == 0:
            # STALE: it only waits for its first tick.
            assert status.level == DiagnosticStatus.STALE
            assert facts["scheduling_policy"] == "SCHED_FIFO"
            assert facts["scheduling_priority"] == str(PRIORITY)
            assert policies == {os.SCHED_FIFO}
        else:
            assert status.level == DiagnosticStatus.WARN
            assert f"--priority {PRIORITY} was refused" in status.message
            assert policies == {os.SCHED_OTHER}
        process.send(signal.SIGINT)
        assert process.wait() == 0
