# SPDX-License-Identifier: Apache-2.0
"""From the command line to the exit code: what is checked, prepared, run, judged and shown."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.context import Context

from tactile_hand_ros.command_line import run_command
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.orchestrator import command, conduct, participation, processes
from tactile_hand_ros.orchestrator.claim import ClaimedError, claim
from tactile_hand_ros.orchestrator.request import Request, _scenarios
from tactile_hand_ros.orchestrator.results import judgement, reading, report, summary, table
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.orchestrator.signals import Interrupted, Signals
from tactile_hand_ros.orchestrator.view import Bar, Lines, Silence
from tactile_hand_ros.ros.domains import isolated_domain
from tactile_hand_ros.scenario.scenario import load_scenario


def test_what_is_not_asked_for_has_its_default() -> None:
    assert vars(Request()) == {
        **{"scenario": "", "named": "", "interactive": False, "duration": None, "pacing": None},
        **{"changes": [], "out": Path("runs"), "record": True, "report": True},
        **{"open_report": False, "composed": None, "separate_recorder": False, "namespace": ""},
        **{"startup_timeout": 30.0, "priority": 0, "cpus": "", "quiet": False},
    }
    assert Request().wanted == "paper" and Request(named="pull").wanted == "pull"
    assert Request(scenario="a", named="b").wanted == "a"
    plan = vars(Plan(load_scenario("paper")))
    del plan["scenario"], plan["scheduling"]
    assert plan == {
        **{"namespace": "/", "record": True, "interactive": False, "composed": False},
        **{"separate_recorder": False, "startup_timeout": 30.0},
    }
    outcome = RunOutcome()
    assert (outcome.failure, outcome.interrupted, outcome.last_tick) == ("", False, -1)
    assert (outcome.complaints, outcome.startup, outcome.plant) == ([], {}, {})


def test_a_shell_completes_the_names_of_scenarios() -> None:
    assert "paper" in _scenarios("pap") and all(n.startswith("pap") for n in _scenarios("pap"))
    assert "pull" in _scenarios("") and _scenarios("no such") == []


@pytest.mark.parametrize("pacing", ["lockstep", "realtime"])
def test_a_run_is_prepared_as_it_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pacing: str
) -> None:
    launcher, seen = SimpleNamespace(), list[Any]()
    monkeypatch.setattr(conduct, "ensure_compiled", lambda: seen.append("compiled"))

    def run(session: Any, joining: Any, request: Any) -> int:
        with pytest.raises(ClaimedError):
            claim(domain, "/left")
        with joining as node:
            assert (node.get_name(), node.get_namespace()) == ("orchestrator", "/left")
            context: Context = node.context
            assert context.ok() and context.get_domain_id() == domain
            with pytest.raises(Exception, match="."):
                node.get_parameter("use_sim_time_not_there")
        seen.append((session, request, context))
        return 7

    monkeypatch.setattr(conduct, "_run", run)
    request = Request(
        **{"pacing": pacing, "duration": 0.25, "namespace": "left", "out": tmp_path / "runs"},
        **{"changes": ["plant.rate=250"], "record": False, "interactive": True, "composed": True},
        **{"separate_recorder": True, "startup_timeout": 4.0, "cpus": "0"},
    )
    with isolated_domain() as domain:
        assert conduct.conduct(request, Signals(), [], launcher) == 7  # type: ignore[arg-type]
        claim(domain, "/left").close()  # free again
    first, (session, passed, context) = seen
    assert first == "compiled" and passed is request and not context.ok()
    plan = session.plan
    assert (plan.scenario.duration, plan.scenario.plant.pacing) == (0.25, pacing)
    assert plan.scenario.plant.rate == 250.0 and plan.namespace == "/left"
    assert (plan.record, plan.interactive, plan.composed) == (False, True, True)
    assert plan.separate_recorder and plan.startup_timeout == 4.0
    assert (plan.scheduling.priority, tuple(plan.scheduling.cpus)) == (0, (0,))
    assert session.directory.path.parent == tmp_path / "runs"
    assert session.directory.path.name.endswith("-paper")


def test_a_signal_before_the_start_leaves_no_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    signals = Signals()

    def interrupted() -> None:
        raise Interrupted("ended by SIGINT")

    monkeypatch.setattr(signals, "check", interrupted)
    monkeypatch.setattr(conduct, "ensure_compiled", lambda: None)
    request = Request(out=tmp_path / "runs")
    with isolated_domain(), pytest.raises(Interrupted):
        conduct.conduct(request, signals, [], SimpleNamespace())  # type: ignore[arg-type]
    assert not (tmp_path / "runs").exists()


def test_an_option_is_named_as_the_user_wrote_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="--duration"):
        conduct._checked(Request(duration=-1.0))
    scenario = conduct._checked(Request(duration=0.5, changes=["duration=0.25"]))
    assert scenario.duration == 0.25


class Shown:
    """A session that ends as it is told, with its directory."""

    def __init__(self, folder: Path, outcome: RunOutcome, **plan: Any) -> None:
        scenario = load_scenario("paper", {"duration": 0.1, **plan.pop("changes", {})})
        self.plan = Plan(scenario, **plan)
        self.directory, self.signals = RunDirectory(folder), Signals()
        self.outcome, self.views = outcome, list[Any]()

    def run(self, joining: Any, view: Any) -> RunOutcome:
        self.views.append((joining, view))
        return self.outcome


def shown(session: Shown, capsys: pytest.CaptureFixture[str], **options: Any) -> tuple[Any, ...]:
    request = Request(**{"quiet": True, **options})
    code = conduct._run(session, contextlib.nullcontext(), request)  # type: ignore[arg-type]
    said = capsys.readouterr()
    return code, said.out.splitlines(), said.err.splitlines()


GOOD, FAR = RunOutcome(position_error=1e-5), RunOutcome(position_error=1e-2)


def test_a_run_says_what_it_is_where_it_writes_and_how_it_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = Shown(tmp_path, GOOD, record=False)
    code, lines, errors = shown(session, capsys)
    assert code == 0 and errors == []
    assert lines == [
        f"paper: {session.plan.scenario.description}",
        f"the nodes start; what they say is in {tmp_path / 'logs'}",
        f"goal reached; everything is in {tmp_path}",
    ]
    assert (tmp_path / "summary.json").is_file()
    code, lines, errors = shown(Shown(tmp_path, FAR, record=False), capsys)
    assert code == 1 and lines[-1].startswith("goal not reached; ") and len(errors) == 1
    assert errors[0].startswith("the final position error is 0.01 m")


@pytest.mark.parametrize(("composed", "asked", "says"), [(True, None, 1), (True, True, 0)])
def test_nodes_that_share_a_process_unasked_are_mentioned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], composed: bool, asked: Any, says: int
) -> None:
    session = Shown(tmp_path, GOOD, record=False, composed=composed)
    _, lines, _ = shown(session, capsys, composed=asked)
    assert sum("--processes gives each node its own" in line for line in lines) == says
    session = Shown(tmp_path, GOOD, record=False)
    assert not any("--processes" in line for line in shown(session, capsys)[1])


def test_who_steers_is_told_how_and_a_bar_has_an_end_only_if_the_run_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = Shown(tmp_path, GOOD, record=False, interactive=True, namespace="/left")
    _, lines, _ = shown(session, capsys, quiet=False)
    (told,) = (line for line in lines if "Ctrl-C ends the run" in line)
    assert told.endswith("--namespace /left")
    ((_, view),) = session.views
    assert isinstance(view, Lines) and view._duration is None
    session = Shown(tmp_path, GOOD, record=False)
    assert not any("Ctrl-C" in line for line in shown(session, capsys, quiet=False)[1])
    assert session.views[0][1]._duration == 0.1
    silent = Shown(tmp_path, GOOD, record=False)
    shown(silent, capsys)
    assert isinstance(silent.views[0][1], Silence) and not isinstance(silent.views[0][1], Bar)


@pytest.mark.parametrize("wanted", [True, False])
def test_report_table_and_pace_are_shown_where_there_are_any(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, wanted: Any
) -> None:
    asked: list[Any] = []

    def read(plan: Any, directory: Any, *, finished: bool) -> Any:
        asked.append((directory, finished))
        return reading.Results({"a": 1})

    monkeypatch.setattr(reading, "read_results", read)
    monkeypatch.setattr(judgement, "judge", lambda *_: judgement.GoalVerdict("x", ["why", "so"], 5))
    monkeypatch.setattr(summary, "write_summary", lambda *args: asked.append(len(args)))
    monkeypatch.setattr(table, "table", lambda *_: "the table")
    slow = SimpleNamespace(too_slow="too slow")
    monkeypatch.setattr(reading, "deadlines_of", lambda *_: slow)
    monkeypatch.setattr(report, "report_line", lambda _: "report: here")
    monkeypatch.setattr(report, "open_report", lambda _: "opened it")
    session = Shown(tmp_path, RunOutcome(failure="broken"))
    code, lines, errors = shown(session, capsys, report=wanted, open_report=wanted)
    assert asked == [(session.directory, False), 5]
    own = ["report: here", "opened it"] if wanted else []
    assert lines[2:] == ["the table", "too slow", *own, f"x; everything is in {tmp_path}"]
    assert (code, errors) == (5, ["why", "so"])
    slow.too_slow = ""
    monkeypatch.setattr(reading, "read_results", lambda *_, finished: reading.Results())
    assert shown(session, capsys, report=False)[1][2:] == [f"x; everything is in {tmp_path}"]


class Bag:
    """Stands in for a run that was read from its bag."""

    def __init__(self, ticks: int = 51, lost: str = "0") -> None:
        recording = {"absent": [], "topics": {}}
        told = {} if lost == "0" else {reading.LOST_KEY: lost}
        self.metrics = SimpleNamespace(to_dict=lambda: {"ticks": ticks})
        self.bag_metrics = SimpleNamespace(to_dict=lambda: dict(recording))
        self.assumptions = [SimpleNamespace(to_dict=lambda: {"name": "A1"})]
        self.recoveries = [SimpleNamespace(to_dict=lambda: {"at": 1.0})]
        self.summary = SimpleNamespace(custom_data=told)


@pytest.mark.parametrize(
    ("ticks", "lost", "finished", "problems"),
    [
        (51, "0", True, []),
        (50, "0", True, ["the bag holds 50 ticks, expected 51"]),
        (50, "0", False, []),
        (51, "1", True, ["the recorder lost 1 message"]),
        (51, "7", False, ["the recorder lost 7 messages"]),
    ],
)
def test_a_bag_is_checked_for_ticks_and_losses(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    ticks: int,
    lost: str,
    finished: bool,
    problems: list[str],
) -> None:
    given: list[Any] = []
    bag = Bag(ticks, lost)
    monkeypatch.setattr(reading, "Run", lambda *args, **own: given.append((args, own)) or bag)
    plan = Plan(load_scenario("paper", {"duration": 0.1}), "/left", interactive=True)
    found = reading.read_results(plan, RunDirectory(tmp_path), finished=finished)
    assert given == [((tmp_path,), {"namespace": "/left", "steered": True})]
    assert found.problems == problems and found.run is bag  # type: ignore[comparison-overlap]
    assert found.recording["expected_ticks"] == (51 if finished else None)
    assert found.recording["lost_messages"] == int(lost)
    assert (found.assumptions, found.recoveries) == ([{"name": "A1"}], [{"at": 1.0}])


@pytest.mark.parametrize("domain", ["", "0", "232"])
def test_domains_that_exist_are_accepted(domain: str) -> None:
    participation.check_environment({"ROS_DOMAIN_ID": domain})
    participation.check_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})


@pytest.mark.parametrize("domain", ["233", "-1", "x", "1.0", "²"])
def test_domains_that_do_not_exist_are_refused(domain: str) -> None:
    with pytest.raises(ConfigurationError, match="expected a whole number from 0 to 232"):
        participation.check_environment({"ROS_DOMAIN_ID": domain})
    with pytest.raises(ConfigurationError, match="RANGE is OFF"):
        participation.check_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off"})


def test_ros_arguments_that_cannot_be_used_are_one_line() -> None:
    with (
        isolated_domain(),
        pytest.raises(ConfigurationError, match="ROS arguments cannot be used: ") as caught,
        participation.ros_context(["x", "--ros-args", "-p", "gain"]),
    ):
        pass
    assert "\n" not in str(caught.value) and ", at " not in str(caught.value)
    assert participation.first_line(ValueError("a\nb, at c")) == "a"


@pytest.fixture
def conducted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """Replace what runs a scenario, and return what is asked of it."""
    launcher, asked = SimpleNamespace(), list[Any]()
    monkeypatch.setattr(processes, "Launcher", lambda: launcher)

    def run(request: Any, signals: Signals, ros_arguments: Any, passed: Any) -> int:
        assert passed is launcher and not gc.isenabled()
        asked.append((request, list(ros_arguments)))
        if request.quiet:
            signals.number, signals.count = 2, 1
            signals.check()
        return 5

    monkeypatch.setattr(command, "_conduct", run)
    monkeypatch.setattr(Signals, "install", lambda self: asked.append("installed"))
    yield asked
    gc.enable()


def test_the_command_line_is_split_into_request_and_ros_arguments(conducted: list[Any]) -> None:
    line = ["orchestrator", "pull", "--ros-args", "-r", "a:=b"]
    assert command.main(line) == 5
    watching, (request, ros_arguments) = conducted
    assert watching == "installed" and request.scenario == "pull" and ros_arguments == line


def test_a_signal_before_the_start_is_said_and_gives_its_code(
    conducted: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["orchestrator", "--quiet"]) == 130
    said = capsys.readouterr().err
    assert said == "orchestrator: ended by SIGINT, before anything was started.\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (["a", "--scenario", "b"], "given twice, as 'a' and as --scenario 'b'"),
        (["--open", "--no-record"], "--open shows the report"),
        (["--open", "--no-report"], "--open shows the report"),
    ],
)
def test_what_contradicts_itself_is_refused(
    conducted: list[Any],
    capsys: pytest.CaptureFixture[str],
    line: list[str],
    words: str,
) -> None:
    assert command.main(["orchestrator", *line]) == 2
    assert words in capsys.readouterr().err and conducted == ["installed"]
    assert command.main(["orchestrator", "--open"]) == 5


def test_malformed_ros_arguments_are_refused_in_a_line() -> None:
    with pytest.raises(ConfigurationError, match="the ROS arguments cannot be used: ") as caught:
        command.split_ros_arguments(["x", "--ros-args", "-r", "no rule"])
        command.split_ros_arguments(["x", "--ros-args", "--", "-r", "--ros-args", "-p"])
        raise ConfigurationError("the ROS arguments cannot be used: this rclpy takes any")
    assert "\n" not in str(caught.value)
    assert run_command("orchestrator", lambda: 3) == 3
