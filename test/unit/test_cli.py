# SPDX-License-Identifier: Apache-2.0
"""The command line: output, rejected input, and exit codes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from support.hands import write_hand
from support.recorded import random_record, write_record

from bench.processes import CapturedProcess, isolated_domain
from tactile_hand_ros.cli import main
from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.hand import example_posture, notes
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import load_scenario, resolved

COMMAND = [Path(sys.executable).with_name("tactile-hand")]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return the folder of a recorded run."""
    write_record(tmp_path / "run" / "bag", random_record())
    (tmp_path / "run" / "scenario.yaml").write_text(resolved(load_scenario("paper")))
    return tmp_path / "run"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Run a command that must be rejected and return its error sentence."""
    assert main([str(a) for a in arguments]) == 2
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    if lines[0].startswith("Usage: "):
        lines = lines[3:]
    assert printed.out == "" and len(lines) == 1 and "Traceback" not in printed.err
    return printed.err


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"]])
def test_help_loads_nothing_heavy(words):
    loading = f"import sys, tactile_hand_ros.cli as c; c.main({words});"
    code = f"{loading} print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    loaded = set(done.stderr.split())
    assert "typer" in loaded
    assert not loaded & {"numpy", "matplotlib", "pinocchio", "rclpy", "joblib", "rosbags"}


def test_a_hand_is_printed_with_its_couplings_and_strength_and_drawn(tmp_path, capsys):
    coupling = {"joint": "f1_joint_3", "ratio": 0.7, "offset": 0.1}
    path = write_hand(tmp_path, [4, 3, 3], couplings={"f1_joint_4": coupling})
    assert main(["hand", str(path), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    rows = [[cell.strip() for cell in line.split("│")] for line in printed.splitlines()]
    assert [row[1:] for row in rows if row[1:2] == ["f1_joint_3"]] == [
        ["f1_joint_3", "f1", "-3 to 3", "30", "20", "f1_joint_4 = 0.7 q +0.1", ""]
    ]
    assert "10 joints, in the order of all arrays" not in printed and "9 joints" in printed
    # The weakest joint has the longest lever, here by differences of the tip's place.
    hand = Hand.load(str(path))
    bent = example_posture(hand) + 1e-6 * np.vstack([np.zeros(9), np.eye(9)])
    tips = np.array([hand.tip_positions(theta)[1] for theta in bent])
    levers = np.linalg.norm(tips[1:] - tips[0], axis=1) / 1e-6
    assert [row[6] for row in rows if row[1:2] == ["f2"]] == [f"{30.0 / levers.max():.2g}"]
    assert (tmp_path / "hand.png").is_file()
    assert "without collision shapes of links" in printed and "damping" not in printed
    path.write_text(path.read_text() + "palm: wrist\n")
    assert "is not a link of" in refused(capsys, "hand", path)
    assert "give a YAML file such as `{urdf: hand.urdf, palm: LINK" in refused(
        capsys, "hand", tmp_path / "hand.urdf"
    )


def test_notes_name_what_a_hand_file_states_and_what_becomes_of_it(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3], limits={"f2_joint_1": {"effort": 1000.0}})
    axes = (tmp_path / "hand.urdf").read_text().split("<axis")
    some = [f'<dynamics damping="0.5" friction="{i}"/><axis{part}' for i, part in enumerate(axes)]
    (tmp_path / "hand.urdf").write_text(
        axes[0] + "".join(some[1:]).replace('effort="30"', 'effort="9"')
    )
    damping, friction, endless, _ = notes(Hand.load(str(path)))
    assert (
        damping.startswith("damping: the file states 0.5 to 0.5 N m s/rad") and "ignores" in damping
    )
    assert friction.startswith("friction: the file states 1 to 9 N m, which the simulation ignores")
    assert endless.startswith("f2_joint_1: the file states no torque limit")
    path.write_text(path.read_text() + "joint_losses: file\n")
    damping, friction, stuck, *_ = notes(Hand.load(str(path)))
    assert "uses" in damping and "uses" in friction
    assert stuck == "f3_joint_3: friction is above the largest torque; nothing moves"


def test_all_scenarios_are_listed_and_one_is_shown(tmp_path, capsys):
    assert main(["scenarios"]) == 0
    printed = capsys.readouterr().out
    assert all(load_scenario(name).description in printed for name in scenario_names())
    assert main(["show", "pull"]) == 0
    file = tmp_path / "pull.yaml"
    file.write_text(capsys.readouterr().out)
    assert load_scenario(str(file)) == load_scenario("pull")


def test_summary(run, capsys):
    assert main(["summary", str(run)]) == 0
    printed = capsys.readouterr().out
    for text in ("paper", "20 ticks", "f_n of finger_2", "not reached", "complete"):
        assert text in printed


def test_a_summary_of_a_hand_that_is_elsewhere_lacks_its_assumptions(run, capsys):
    text = (run / "scenario.yaml").read_text()
    (run / "scenario.yaml").write_text(text.replace("hand: paper", "hand: ~nobody-here/hand.yaml"))
    assert main(["summary", str(run)]) == 0
    printed = capsys.readouterr()
    said = "note: The assumptions are omitted because the hand cannot be loaded: hand file '~no"
    assert printed.err.startswith(said) and printed.err.count("\n") == 1
    assert "20 ticks" in printed.out and "held" not in printed.out


def test_recover(run, capsys):
    file = run / "bag" / "bag_0.mcap"
    assert main(["recover", str(run), "--out", str(run / "copy")]) == 0
    assert capsys.readouterr().out.endswith("nothing is lost\n")
    file.write_bytes(file.read_bytes()[:-3000])
    assert "tactile-hand recover" in refused(capsys, "summary", run)
    assert main(["recover", str(run)]) == 0
    assert "recovered 361 messages" in capsys.readouterr().out
    assert main(["summary", str(run / "bag_recovered")]) == 0
    capsys.readouterr()
    assert "exists already" in refused(capsys, "recover", run)


def test_a_replay_that_no_node_could_receive_is_refused(run, capsys, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    assert "set it to LOCALHOST or SUBNET" in refused(capsys, "replay", run)


def test_a_namespace_without_a_hand_and_an_empty_name(run, capsys):
    assert "the scenario is ''" in refused(capsys, "run", "")
    assert "in the namespaces: /; choose" in refused(capsys, "summary", run, "--namespace=left")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("show papr", "did you mean 'paper'"),
        ("reproduce --layout=fist --out=x", "no layout 'fist'"),
        ("reproduce --duration=nan --out=x", "duration is nan"),
        ("reproduce --jobs 0", "expected 1 or more processes"),
        ("reproduce --jobs -5", "expected 1 or more processes, or -1 for all cores, got -5"),
        ("frobnicate", "No such command 'frobnicate'"),
        ("show", "Missing argument"),
        ("rum", "Did you mean 'run'"),
        ("run --pacin realtime", "--pacing"),
        ("run paper twice", "'tactile-hand run --help'"),
        ("run paper --scenario pull", "given twice"),
    ],
)
def test_unknown_names_and_wrong_usage(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert said in refused(capsys, *words.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["squeeze", "-3"], "no hand is running"),  # and not: there is no option -3
        (["move", "-1", "-0.1", "0.4"], "no hand is running"),
        (["move", "nan", "0", "0"], "nan is not a finite number"),
        (["squeeze", "inf"], "inf is not a finite number"),
        (["squeeze", "1", "--namespace", "left"], "namespace '/left'"),
        (["move", "0", "0", "0", "--rotation", "0", "-1", "nan"], "nan is not a finite number"),
    ],
)
def test_steering_takes_any_number_and_refuses_what_is_none(words, said, capsys):
    with isolated_domain():
        assert said in refused(capsys, *words, "--timeout", "0.1")


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("RMW_IMPLEMENTATION", "rmw_none_cpp", "which is not installed here"),
        ("HOME", None, "no hand is running"),
        ("HOME", "/dev/null", "no hand is running"),  # a folder for logs cannot be made
    ],
)
def test_a_middleware_or_a_home_that_is_missing_is_one_sentence(variable, value, said):
    with isolated_domain():
        environment = {**os.environ, "ROS_HOME": None, "ROS_LOG_DIR": None, variable: value}
        done = subprocess.run(
            [*COMMAND, "squeeze", "1", "--timeout", "0.1"],
            capture_output=True,
            text=True,
            timeout=60,
            env={key: text for key, text in environment.items() if text is not None},
        )
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1


def test_an_rclpy_that_cannot_be_loaded_is_one_sentence(capsys):
    def load() -> None:
        raise ImportError("No module named 'rclpy._rclpy_pybind11'", name="rclpy._rclpy_pybind11")

    assert run_command("hand", load) == 2
    said = capsys.readouterr().err
    assert "a new shell if this one has sourced another ROS" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "wanted", "speed", "motion"),
    [
        ([], "gravity", 1, [{"time": 0, "rotation": [0, 0, 0]}]),
        (["--set", "plant.speed=2", "--set", "plant.palm_motion=[]"], "gravity", 2, []),
        (["--scenario", "forearm"], "forearm", 1, None),
    ],
)
def test_live_runs_at_real_time_and_lets_the_page_turn_the_palm(
    words, wanted, speed, motion, monkeypatch
):
    begun = []
    monkeypatch.setattr(
        "tactile_hand_ros.orchestrator.command.start", lambda options, *_: begun.append(options)
    )
    assert main(["live", *words]) == 0
    [options] = begun
    assert options.wanted == wanted and options.interactive and options.composed
    changes = parse_changes(options.changes)
    assert changes["plant.speed"] == speed and changes.get("plant.palm_motion") == motion


def test_live_without_the_library_of_its_page_starts_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "aiohttp", None)  # it cannot be imported
    with isolated_domain():
        code = main(["live", "--out", str(tmp_path / "runs"), "--no-browser"])
    assert code == 2 and "`pip install aiohttp`" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_finished_run_is_shown_as_its_report(run, capsys):
    assert main(["live", "--bag", str(run), "--no-browser"]) == 0
    shown = capsys.readouterr().out.split()
    assert Path(shown[-1]).read_text().startswith("<!doctype html>")


def test_reproduce_writes_figures_and_report(tmp_path, capsys):
    """A tenth of a second is no experiment, as the verdict reports."""
    arguments = ["--layout", "pinch", "--duration", "0.1", "--jobs", "1"]
    assert main(["reproduce", "--out", str(tmp_path), *arguments]) == 0
    printed = capsys.readouterr().out
    assert "does not hold" in printed and "layout pinch" in printed
    names = {file.name for file in tmp_path.iterdir()}
    figures = {f"{name}_pinch.png" for name in ("fig2", "fig3", "fig4")}
    assert names == {*figures, *(name.replace("png", "svg") for name in figures), "reproduction.md"}
    report = (tmp_path / "reproduction.md").read_text()
    assert all(name in report for name in figures) and "| does not hold |" in report


def test_interrupted_reproduction_leaves_nothing(tmp_path):
    """Ctrl-C reaches the whole group; neither a process nor a traceback remains."""
    command = [*COMMAND, "reproduce", "--out", str(tmp_path / "out")]
    with CapturedProcess(command) as process:
        started = psutil.Process(process.pid).children
        wait_until(lambda: len(started()) >= 2, 60.0, "workers to start")
        workers = started()
        process.send_to_group(signal.SIGINT)
        # During some imports, Python turns an interrupt into death by that very signal.
        assert process.wait(30.0) in (130, -signal.SIGINT), process.stderr
        wait_until(lambda: not any(each.is_running() for each in workers), 20.0, "workers to end")
        # An interrupt while Python itself starts is its own fatal error, with frozen files only.
        assert 'File "/' not in process.stderr
