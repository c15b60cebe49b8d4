# SPDX-License-Identifier: Apache-2.0
"""Threads that resend messages block no others, and one that has ended is no refusal."""

import contextlib
import os
import threading
from pathlib import Path
from unittest.mock import Mock

from tactile_hand_ros.ros.diagnostics import OK, Diagnostics
from tactile_hand_ros.ros.scheduling import raise_priority, report_scheduling, yield_while_resending


def _policies_of_thread(name):
    """Request SCHED_FIFO 2 in a thread of that name; return its policy before and after."""
    seen = []

    def policy(thread):
        return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority

    def run():
        thread = threading.get_native_id()
        Path(f"/proc/self/task/{thread}/comm").write_text(name, encoding="utf-8")
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(2))
        seen.append(policy(thread))
        yield_while_resending()
        seen.append(policy(thread))

    worker = threading.Thread(target=run)
    worker.start()
    worker.join()
    return seen


def test_only_threads_that_resend_make_way_for_all_others():
    asked, got = _policies_of_thread("dds.asyn.0.0")
    assert got == ((os.SCHED_FIFO, 1) if asked[0] == os.SCHED_FIFO else asked)
    asked, got = _policies_of_thread("dds.ev.0")
    assert got == asked


def test_a_thread_that_has_ended_meanwhile_is_no_refusal(monkeypatch):
    monkeypatch.setattr(os, "sched_setscheduler", Mock(side_effect=ProcessLookupError))
    raise_priority(5)
    diagnostics = Diagnostics("node")
    report_scheduling(diagnostics)
    assert diagnostics.status().level == OK
