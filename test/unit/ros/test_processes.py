# SPDX-License-Identifier: Apache-2.0
"""Executables are found where ``ros2 run`` looks, or the answer is a sentence."""

import pytest

from tactile_hand_ros.ros.processes import ExecutableError, executable_path


@pytest.mark.parametrize("prefix", [None, "", "/nowhere"])
def test_an_index_that_is_not_there_is_named(monkeypatch, prefix):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    if prefix is not None:
        monkeypatch.setenv("AMENT_PREFIX_PATH", prefix)
    with pytest.raises(ExecutableError, match=f"AMENT_PREFIX_PATH='{prefix or ''}'"):
        executable_path("plant")


def test_an_unknown_executable_is_named_with_the_known_ones():
    with pytest.raises(ExecutableError, match="'no_such_node': choose one of composed, "):
        executable_path("no_such_node")
