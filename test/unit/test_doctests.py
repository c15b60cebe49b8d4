# SPDX-License-Identifier: Apache-2.0
"""The examples in the docstrings of the front door and of the law interface."""

import doctest
import importlib
from pathlib import Path

from support.recorded import write_record

from tactile_hand_ros import simulate

MODULES = ("front_door", "sweep", "run.run", "run.metrics", "control.laws")


def test_the_examples_give_their_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = simulate("paper", {"duration": 0.1, "targets": []}).record
    write_record(Path("runs/latest/bag"), record)
    for name in MODULES:
        found = doctest.testmod(importlib.import_module(f"tactile_hand_ros.{name}"))
        assert found.attempted and not found.failed, name
