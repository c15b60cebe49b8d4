# SPDX-License-Identifier: Apache-2.0
"""The options for the kernel's scheduler are read, written, and rejected with a reason."""

import contextlib
import os
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.scheduling import take_priority, yield_while_resending


@given(st.integers(0, 99))
def test_what_is_written_is_read(priority):
    assert take_priority(["--priority", str(priority)]) == (priority, [])


def test_other_words_are_left_alone():
    words = ["--priority=7", "-h", "other"]
    assert take_priority(words) == (7, ["-h", "other"])
    assert take_priority([]) == (0, [])


@pytest.mark.parametrize(
    "words", [["--priority"], ["--priority", "100"], ["--priority", "-1"], ["--priority=high"]]
)
def test_nonsense_is_refused(words):
    with pytest.raises(ConfigurationError, match=words[0].partition("=")[0]):
        take_priority(words)


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
