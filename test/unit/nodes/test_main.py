# SPDX-License-Identifier: Apache-2.0
"""Each executable runs its node with the arguments that it was given."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import pytest

from tactile_hand_ros.names import RECORD
from tactile_hand_ros.nodes import composed
from tactile_hand_ros.nodes.recorder import node as recorder

NODES = {
    "force_optimizer": "ForceOptimizerNode",
    "manipulation_controller": "ManipulationControllerNode",
    "plant": "PlantNode",
    "slip_regulator": "SlipRegulatorNode",
    "tactile_sensor": "TactileSensorNode",
    "viewer": "ViewerNode",
}


@pytest.mark.parametrize(("name", "node"), NODES.items())
def test_a_node_is_run_with_its_arguments_and_ends_with_its_exit_code(
    name: str, node: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module(f"tactile_hand_ros.nodes.{name}.node")
    given: list[Any] = []
    monkeypatch.setattr(module, "run_node", lambda *args: given.extend(args) or 5)
    assert module.main(["program", "--help"]) == 5
    assert given == [getattr(module, node), ["program", "--help"]]


def test_the_recorder_may_be_late(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    monkeypatch.setattr(recorder, "use_batch_scheduling", lambda: given.append("batch"))
    monkeypatch.setattr(recorder, "run_node", lambda *args: given.extend(args) or 5)
    assert recorder.main(["program"]) == 5
    assert given == ["batch", recorder.RecorderNode, ["program"]]


@pytest.mark.parametrize("records", [False, True])
def test_all_nodes_share_a_process_with_the_recorder_on_request(
    records: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(composed, "run_nodes", lambda *args: given.extend(args) or 5)
    line = ["program", *([RECORD] if records else []), "--ros-args"]
    assert composed.main(line) == 5
    kinds, passed = given
    assert [kind.__name__ for kind in kinds] == [
        *(["RecorderNode"] if records else []),
        *(NODES[name] for name in ("manipulation_controller", "force_optimizer")),
        *(NODES[name] for name in ("tactile_sensor", "slip_regulator", "plant")),
    ]
    assert passed == ["program", "--ros-args"] and len(line) == 2 + records
    given.clear()
    monkeypatch.setattr(sys, "argv", ["other"])
    composed.main()
    assert given[1] == ["other"]
