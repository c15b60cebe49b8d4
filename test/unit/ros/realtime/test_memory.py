# SPDX-License-Identifier: Apache-2.0
"""A process locks its memory and uses its stack ahead, as the kernel's own figures show."""

from __future__ import annotations

import subprocess
import sys

_SHOW = """
import re
from tactile_hand_ros.ros.realtime.memory import keep_heap, lock_memory, touch_stack
def kilobytes(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1])
stack = kilobytes("VmStk")
touch_stack()
keep_heap()
refused = lock_memory()
print(kilobytes("VmStk") - stack, kilobytes("VmLck"), refused)
"""
_WITHOUT_RIGHT = """
import ctypes, os, resource
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
os.setresuid(65534, 65534, 65534) if os.geteuid() == 0 else None
"""


def shown(script: str) -> tuple[int, int, str]:
    """Return by how much the stack grew [KiB], what is locked [KiB], and why it is not."""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    stack, locked, *reason = ran.stdout.split(maxsplit=2)
    return int(stack), int(locked), "".join(reason)


def test_memory_is_locked_where_that_is_permitted_and_the_stack_is_there() -> None:
    stack, locked, reason = shown(_SHOW)
    assert stack >= 200
    assert (locked > 1000) is not bool(reason)


def test_without_the_right_nothing_is_locked_and_it_says_what_to_do() -> None:
    import_first = "import tactile_hand_ros.ros.realtime.memory\n"
    _, locked, reason = shown(import_first + _WITHOUT_RIGHT + _SHOW)
    assert locked == 0
    assert "memlock" in reason
