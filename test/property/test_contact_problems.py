# SPDX-License-Identifier: Apache-2.0
"""Random contact problems, from a single contact to six that are redundant, with mu from 0 to 100.

More of them, 20,000 unless a range is given, and the slowest one:
PYTHONPATH=test python <this file> [first last]
"""

import sys
import time

import numpy as np
import pytest
from support.contact_problems import failure, is_jammed, random_problem

from tactile_hand_ros.simulation.alart_curnier import TOLERANCE, contact_laws
from tactile_hand_ros.simulation.central_path import follow_path
from tactile_hand_ros.simulation.coulomb import solve_contacts


def failures(seeds):
    """Return what is wrong with the answers to problems, by seed."""
    found = ((seed, failure(random_problem(seed))) for seed in seeds)
    return {seed: reason for seed, reason in found if reason}


def test_laws_hold_in_every_problem():
    assert not failures(range(500))


@pytest.mark.parametrize("seed", [1972, 2348, 2659, 4515, 5052, 5717, 6826, 7160, 18006])
def test_laws_hold_in_the_hardest_problems(seed):
    """Few starts of Newton's method lead to a solution of these; the curve to it turns back."""
    assert not failures([seed])


@pytest.mark.parametrize("seed", [88, 112, 265, 2411])
def test_a_path_sees_that_an_object_is_jammed(seed):
    problem = random_problem(seed)
    assert is_jammed(problem)
    _, left, jammed = path(problem, 1000)
    assert jammed and left > TOLERANCE
    assert not path(random_problem(5717), 1000)[2]


def test_a_path_ends_where_it_has_taken_too_long():
    assert path(random_problem(5717), 1000)[1] < TOLERANCE < path(random_problem(5717), 50)[1]


def path(problem, most):
    """Return what the first path of a problem finds with so many linear systems."""
    offset = problem.free.copy()
    offset[1::3] += problem.closing
    return follow_path(contact_laws(problem.delassus, offset, problem.friction), 0.1, 0.01, most)


def duration(seed):
    """Return how long the solution of a problem takes, the better of two times, s."""
    _, *given, _ = random_problem(seed)
    times = []
    for _ in range(2):
        start = time.perf_counter()
        solve_contacts(*given, np.zeros((len(given[1]) // 3, 3)))
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    chosen = range(*map(int, sys.argv[1:3])) if len(sys.argv) > 2 else range(20_000)
    wrong, slowest = failures(chosen), max(chosen, key=duration)
    for seed, reason in wrong.items():
        print(f"problem {seed}: {reason}")
    print(f"{len(wrong)} failures in {len(chosen)} problems")
    print(f"the slowest, {slowest}, takes {1e3 * duration(slowest):.1f} ms")
    sys.exit(bool(wrong))
