# SPDX-License-Identifier: Apache-2.0
"""A node runs as it was asked to run where the system permits it, and says so where not."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from support.nodes import Process

from bench.processes import CapturedProcess
from tactile_hand_ros import names
from tactile_hand_ros.ros.processes import executable_path

PRIORITY = 7

# Becomes another program that may not use SCHED_FIFO, whoever starts it.
_WITHOUT_RIGHT = """
import ctypes, os, resource, sys
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23
ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE)
os.execv(sys.argv[1], sys.argv[1:])
"""
_TRY = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"


@pytest.mark.parametrize("permitted", [True, False])
def test_fifo_where_it_is_permitted_and_a_warning_where_not(here: Process, permitted: bool) -> None:
    tried = subprocess.run([sys.executable, "-c", _TRY], capture_output=True)
    wrapper = [] if permitted else [sys.executable, "-c", _WITHOUT_RIGHT]
    command = [str(executable_path("force_optimizer")), "--priority", str(PRIORITY)]
    with CapturedProcess([*wrapper, *command]) as process:
        here.receive(DiagnosticArray, names.DIAGNOSTICS)
        (status,) = here.messages(names.DIAGNOSTICS, 1)[-1].status
        facts = {pair.key: pair.value for pair in status.values}
        threads = [int(path.name) for path in Path(f"/proc/{process.pid}/task").iterdir()]
        policies = {os.sched_getscheduler(thread) for thread in threads}
        assert len(threads) > 1  # of the middleware
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
