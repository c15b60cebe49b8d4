# SPDX-License-Identifier: Apache-2.0
"""What is run so that all of it is compiled: every block, with grasps that stick and that slip."""

import pytest

from tactile_hand_ros.closed_loop import warm_up


@pytest.mark.parametrize("complete", [False, True])
def test_it_is_done_once_for_the_same_sources(complete, monkeypatch):
    done = []
    monkeypatch.setattr(warm_up, "is_complete", lambda: complete)
    monkeypatch.setattr(warm_up, "run_every_block", lambda: done.append("run"))
    monkeypatch.setattr(warm_up, "mark_complete", lambda: done.append("marked"))
    warm_up.warm_up()
    assert done == ([] if complete else ["run", "marked"])
