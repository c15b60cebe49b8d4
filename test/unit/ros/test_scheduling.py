# SPDX-License-Identifier: Apache-2.0
"""The options for the kernel's scheduler are read, written and refused with a reason."""

import contextlib
import os
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.scheduling import (
    Scheduling,
    format_cpus,
    parse_cpus,
    present_cpus,
    take_scheduling,
    yield_while_resending,
)


def lists_of(numbers):
    return st.sets(numbers).map(sorted).map(tuple)


@given(st.integers(0, 99), lists_of(st.sampled_from(present_cpus())))
def test_what_is_written_is_read(priority, cpus):
    asked = Scheduling(priority, cpus)
    assert take_scheduling(asked.arguments) == (asked, [])


def test_a_processor_that_is_not_there_is_refused():
    assert set(os.sched_getaffinity(0)) <= set(present_cpus())
    missing = present_cpus()[-1] + 1
    with pytest.raises(ConfigurationError, match=f"no processor {missing}; it has 0"):
        take_scheduling(["--cpus", f"0-{missing + 2}"])


def test_other_words_are_left_alone():
    words = ["--priority=7", "-h", "--cpus", "0", "other"]
    assert take_scheduling(words) == (Scheduling(7, (0,)), ["-h", "other"])
    assert take_scheduling([]) == (Scheduling(), [])


def test_ranges():
    assert parse_cpus("3,0-1,1") == (0, 1, 3)
    assert format_cpus((0, 1, 3)) == "0,1,3"


@pytest.mark.parametrize(
    "words",
    [
        ["--priority"],
        ["--priority", "100"],
        ["--priority", "-1"],
        ["--priority=high"],
        ["--cpus"],
        ["--cpus", "2-1"],
        ["--cpus=0,,1"],
        ["--cpus", "a-b"],
    ],
)
def test_nonsense_is_refused(words):
    with pytest.raises(ConfigurationError, match=words[0].partition("=")[0]):
        take_scheduling(words)


def _policies_of_thread(name):
    """Ask for SCHED_FIFO 2 in a thread of that name; return what it has before and after."""
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
