# SPDX-License-Identifier: Apache-2.0
"""The memory of the compiler is given back, and the compiler works all the same."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import os
import numpy as np
from tactile_hand_ros.jit.release import release_compiler
import numba

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

@numba.njit
def twice(x):
    return 2 * x

twice(1)
before = resident()
release_compiler()
print(before - resident(), twice(2), twice(np.ones(3)).tolist())
"""


def test_pages_of_the_compiler_are_given_back_until_it_is_needed() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    freed, rest = done.stdout.split(maxsplit=1)
    assert float(freed) > 20.0 and rest == "4 [2.0, 2.0, 2.0]\n"
