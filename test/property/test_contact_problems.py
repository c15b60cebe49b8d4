# SPDX-License-Identifier: Apache-2.0
"""Random contact problems, from a single contact to six that are redundant, with mu from 0 to 100.

More of them, 20,000 unless a number is given: PYTHONPATH=test python <this file> [number]
"""

import sys
import time

from support.contact_problems import failure, random_problem


def failures(number):
    """Return what is wrong with the answers to the first problems, by seed."""
    found = ((seed, failure(random_problem(seed))) for seed in range(number))
    return {seed: reason for seed, reason in found if reason}


def test_laws_hold_in_every_problem():
    assert not failures(500)


if __name__ == "__main__":
    count, start = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000, time.monotonic()
    wrong = failures(count)
    for seed, reason in wrong.items():
        print(f"problem {seed}: {reason}")
    print(f"{len(wrong)} failures in {count} problems, {time.monotonic() - start:.0f} s")
    sys.exit(bool(wrong))
