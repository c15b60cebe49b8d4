# SPDX-License-Identifier: Apache-2.0
"""A random hand of the study finds a grasp and keeps its object."""

from studies.random_hands import COLUMNS, tried
from tactile_hand_ros.scenario import grasp_search


def test_a_random_hand_keeps_its_object_without_commands_and_under_a_pull(monkeypatch):
    monkeypatch.setattr(grasp_search, "STARTS", 6)
    row = dict(zip(COLUMNS, tried(47), strict=True))
    for effect in (row["start"], row["stopped 1 s"], row["pull"]):
        moved, slid = effect.removesuffix(" mm").split(", slid ")
        assert float(moved) < 3.0 and float(slid) < 0.5, row
