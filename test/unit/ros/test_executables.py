# SPDX-License-Identifier: Apache-2.0
"""Where there is no ament index at all, the answer is a sentence."""

import pytest

from tactile_hand_ros.ros import processes as executables
from tactile_hand_ros.ros.processes import (
    ExecutableError,
    executable_directory,
    executable_path,
    main,
)


@pytest.mark.parametrize("prefix", [None, "", "/nowhere"])
def test_an_index_that_is_not_there_is_named(monkeypatch, capsys, prefix):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    if prefix is not None:
        monkeypatch.setenv("AMENT_PREFIX_PATH", prefix)
    with pytest.raises(ExecutableError, match=f"AMENT_PREFIX_PATH='{prefix or ''}'"):
        executable_directory()
    assert main(["plant"]) == 2
    assert "does not know tactile_hand_ros" in capsys.readouterr().err


def test_an_unknown_executable_is_named_with_the_known_ones():
    with pytest.raises(ExecutableError, match="'no_such_node': choose one of composed, "):
        executable_path("no_such_node")


def test_an_executable_is_become_with_its_arguments(monkeypatch):
    become = []
    monkeypatch.setattr(executables.os, "execve", lambda *args: become.extend(args))
    main(["plant", "--help"])
    path = executable_path("plant")
    assert become == [path, [str(path), "--help"], executables.child_environment()]


def test_what_is_no_executable_is_refused(capsys):
    assert main(["plnt"]) == 2 and main([]) == 2
    assert "plnt" in capsys.readouterr().err
