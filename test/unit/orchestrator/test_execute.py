# SPDX-License-Identifier: Apache-2.0
"""From options to exit code: rejected input, for which nothing is started."""

import io
import os
import re
import signal
from pathlib import Path

import pytest

from bench.processes import isolated_domain
from tactile_hand_ros.command_line import Interrupted, Signals
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.names import PLANT, RECORDER
from tactile_hand_ros.orchestrator.command import main, split_ros_arguments
from tactile_hand_ros.orchestrator.execute import (
    _conclude,
    execute,
    shares_process,
    single_run_lock,
)
from tactile_hand_ros.orchestrator.monitor import line_console
from tactile_hand_ros.orchestrator.options import RunOptions
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import STOP_ORDER, Plan, RunOutcome
from tactile_hand_ros.ros.middleware import full_namespace, graph_node, ros_context
from tactile_hand_ros.scenario.scenario import load_scenario

SCENARIO = load_scenario("paper", {"duration": 0.1})


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"scenario": "papr"}, "did you mean 'paper'"),
        ({"scenario": "broken.yaml"}, "broken.yaml: line 3, .* is not valid YAML"),
        ({"duration": -1.0}, "duration is -1"),
        ({"changes": ["plant.rte=500"]}, "did you mean 'rate'"),
        ({"changes": ["targets=[{position: [9, 9, 9]}]"]}, "out of reach"),
        ({"namespace": "1st"}, "the namespace is '1st'"),
        ({"priority": 100}, "--priority is '100'"),
    ],
)
def test_what_is_refused_starts_nothing(tmp_path, monkeypatch, options, complaint):
    monkeypatch.chdir(tmp_path)
    Path("broken.yaml").write_text("extends: paper\nplant: {rate: 500\n")
    with pytest.raises(TactileHandError, match=complaint):
        execute(RunOptions(out=tmp_path / "runs", **options), Signals())
    assert not (tmp_path / "runs").exists()


@pytest.mark.usefixtures("handlers")
def test_a_signal_before_the_start_leaves_no_directory(tmp_path):
    signals = Signals().install()
    os.kill(os.getpid(), signal.SIGINT)
    with isolated_domain(), pytest.raises(Interrupted, match="SIGINT"):
        execute(RunOptions(out=tmp_path / "runs"), signals)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("place", ["/locked_by_a_test", f"/{'a' * 200}"])
def test_one_run_has_a_domain_and_namespace_until_it_ends(place):
    """Even a namespace that is longer than a socket name may be."""
    with (
        single_run_lock(231, place),
        single_run_lock(230, place),
        single_run_lock(231, place + "b"),
    ):
        expected = f"in ROS domain 231 and namespace '{place}'"
        with pytest.raises(TactileHandError, match=re.escape(expected)):
            with single_run_lock(231, place):
                pass
    with single_run_lock(231, place):
        pass


def test_nodes_share_a_process_in_real_time_unless_asked_otherwise():
    real_time = load_scenario("paper", {"plant.pacing": "realtime"})
    assert shares_process(real_time, None) and not shares_process(real_time, False)
    assert shares_process(SCENARIO, True) and not shares_process(SCENARIO, None)


def test_a_run_ends_with_the_tick_at_its_duration_or_never_and_the_recorder_ends_last():
    assert Plan(SCENARIO).end == 100_000_000
    assert Plan(SCENARIO, interactive=True).end is None
    assert STOP_ORDER[-1] == (RECORDER,) and PLANT in STOP_ORDER[0]


@pytest.mark.parametrize("failure", ["plant ended", ""])
def test_without_room_for_the_summary_the_reasons_are_still_told(tmp_path, capsys, failure):
    directory, plan = RunDirectory(tmp_path), Plan(SCENARIO, record=False)
    directory.summary.mkdir()
    ending = plan, directory, RunOutcome(failure=failure), RunOptions(), 0
    assert _conclude(*ending, line_console(io.StringIO())) == 1
    told = capsys.readouterr().err.splitlines()
    assert told == [*filter(None, [failure]), "summary.json cannot be written: Is a directory"]


@pytest.mark.parametrize(
    ("given", "arguments", "expected"),
    [
        ("", [], "/"),
        ("/", [], "/"),
        ("left", [], "/left"),
        ("/left/", [], "/left"),
        ("/a/b_2", [], "/a/b_2"),
        ("", ["x", "--ros-args", "-r", "__ns:=/right"], "/right"),
        ("left", ["x", "--ros-args", "-r", "__ns:=/right"], "/left"),
    ],
)
def test_a_namespace_is_an_option_or_a_ros_argument(given, arguments, expected):
    assert full_namespace(given, arguments) == expected


@pytest.mark.parametrize("given", ["1st", "a-b", "a//b", "a b"])
def test_a_bad_namespace_is_refused(given):
    with pytest.raises(ConfigurationError, match=f"'{given}'"):
        full_namespace(given)


def test_a_node_takes_part_without_parameter_services():
    with isolated_domain() as domain, ros_context() as context:
        assert context.get_domain_id() == domain
        with graph_node(context, "someone", "/left") as node:
            assert node.get_fully_qualified_name() == "/left/someone"
            offered = node.get_service_names_and_types_by_node("someone", "/left")
            assert not [name for name, _ in offered if "parameters" in name]
    assert not context.ok()


def test_ros_arguments_are_taken_out():
    line = ["orchestrator", "--quiet", "--ros-args", "-r", "a:=b", "--", "--duration", "1"]
    assert split_ros_arguments(line) == (["--quiet", "--duration", "1"], line)
    assert split_ros_arguments(["orchestrator", "--quiet"]) == (["--quiet"], [])


@pytest.mark.usefixtures("handlers")
def test_the_executable_refuses_in_one_sentence(capsys):
    assert main(["orchestrator", "papr"]) == 2
    printed = capsys.readouterr()
    assert "did you mean 'paper'" in printed.err and printed.err.count("\n") == 1
