# SPDX-License-Identifier: Apache-2.0
"""The skin of a finger fails before a load or during a move; the others and the joints suffice."""

import numpy as np
import pytest
from support.outcomes import InParallel, run_with_failing_skin

CASES = {
    "pulled, off": ("human_pull", 2, "off", 1.0, 3.0),
    "pulled, stuck": ("human_pull", 0, "stuck", 1.0, 3.0),
    "pulled, wrong": ("human_pull", 1, "wrong", 1.0, 3.0),
    "moving, off": ("gravity", 0, "off", 1.5, 4.0),
    "moving, whole": ("gravity", 0, "none", 1.5, 4.0),
}


@pytest.fixture(scope="module")
def records():
    return InParallel(run_with_failing_skin, CASES)


@pytest.mark.parametrize("name", CASES)
def test_the_object_is_kept_and_nothing_slides(records, name):
    """Without the joints, the load would be unknown, and the object lost to 1.5 N."""
    record = records[name]
    assert record.stamps[-1] > 0 and np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 1e-4
    assert np.isfinite(record.auxiliary_position[-1]).all()  # it goes on, without a hold


def test_a_pull_displaces_the_object_as_little_as_with_a_whole_skin(records):
    for name in CASES:
        if name.startswith("pulled"):
            moved = np.linalg.norm(np.diff(records[name].object_position[[1000, -1]], axis=0))
            assert moved < 1e-3, name


def test_the_hand_moves_on_and_knows_where(records):
    """The contact of the finger without a skin moves as if it were felt."""
    record, whole = records["moving, off"], records["moving, whole"]
    assert np.linalg.norm(record.object_position[-1] - record.object_position[1500]) > 0.1
    away = np.linalg.norm(record.object_position - whole.object_position, axis=1)
    assert away.max() < 0.01
    true = record.true_positions.mean(axis=1)
    assert np.linalg.norm(record.auxiliary_position - true, axis=1).max() < 5e-4
