# SPDX-License-Identifier: Apache-2.0
"""A run from its plan to its end: processes, their arguments, what is missing, when it stalls."""

from __future__ import annotations

import contextlib
import errno
import gc
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from rclpy.node import Node

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import (
    COMPOSED,
    CONTROLLER,
    OPTIMIZER,
    PLANT,
    RECORDER,
    REGULATOR,
    SENSOR,
)
from tactile_hand_ros.orchestrator import session as session_module
from tactile_hand_ros.orchestrator.claim import ClaimedError, claim
from tactile_hand_ros.orchestrator.monitor import Look
from tactile_hand_ros.orchestrator.processes import NodeDiedError
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import (
    STOP_ORDER,
    Plan,
    RunOutcome,
    Session,
    StallError,
    StartupError,
)
from tactile_hand_ros.orchestrator.signals import Interrupted, Signals
from tactile_hand_ros.orchestrator.steering import UserForces
from tactile_hand_ros.orchestrator.view import Silence
from tactile_hand_ros.orchestrator.wiring import Gap
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.ros.scheduling import Scheduling
from tactile_hand_ros.scenario.scenario import UserForceConfig, load_scenario

SCENARIO = load_scenario("paper", {"duration": 0.1, "plant.rate": 250.0})
ALL = (RECORDER, PLANT, CONTROLLER, OPTIMIZER, REGULATOR, SENSOR)
TELLING = "echo \"$@\"; trap 'exit 0' INT; while :; do tail -f /dev/null & wait; done"


class Shells:
    """Stands in for the launcher: each executable is a shell that says its arguments."""

    def command(self, name: str) -> list[str]:
        """Return the shell with its program."""
        return ["/bin/sh", "-c", TELLING, name]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Session]]:
    """Return a function that makes a session of shells in the folder of the test."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as held:

        def _make(**plan: Any) -> Session:
            asked = Plan(**{"scenario": SCENARIO, **plan})
            return Session(asked, RunDirectory(tmp_path), Shells(), Signals(), held)  # type: ignore[arg-type]

        for folder in ("logs", "parameters"):
            (tmp_path / folder).mkdir()
        yield _make
    gc.unfreeze()


@contextlib.contextmanager
def when_they_have_spoken(session: Session, error: Exception) -> Iterator[Node]:
    """Join when each process has told its arguments, and end the run with an error."""
    logs = list((session.directory.path / "logs").iterdir())
    wait_until(lambda: all(log.read_text() for log in logs))
    raise error
    yield


def told(session: Session, error: Exception | None = None) -> dict[str, list[str]]:
    """Run and return the arguments of each process."""
    session.run(when_they_have_spoken(session, error or TactileHandError("enough")), Silence())
    logs = sorted((session.directory.path / "logs").iterdir())
    return {log.stem: log.read_text().split("\n")[0].split() for log in logs}


def files(session: Session, *nodes: str) -> list[str]:
    folder = session.directory.path / "parameters"
    return [word for name in nodes for word in ("--params-file", str(folder / f"{name}.yaml"))]


COMMON = ["--ros-args", "--disable-external-lib-logs"]


def test_each_node_gets_its_parameters_and_ends_well(make: Callable[..., Session]) -> None:
    session = make(scheduling=Scheduling(0, (0,)))
    gc.disable()
    arguments = told(session)
    assert gc.isenabled() and gc.get_freeze_count() > 0
    assert sorted(arguments) == sorted(ALL)
    pinned = list(Scheduling(0, (0,)).arguments)
    assert pinned
    for name, words in arguments.items():
        own = [] if name == RECORDER else pinned  # it may be late
        assert words == [*own, *COMMON, *files(session, name)]
    outcome = session.outcome
    assert (outcome.failure, outcome.interrupted, outcome.complaints) == ("enough", False, [])
    assert list(outcome.startup) == ["checked", "processes_started"]


def test_nodes_of_one_process_share_their_arguments(make: Callable[..., Session]) -> None:
    session = make(composed=True, namespace="/left")
    inside = (RECORDER, PLANT, CONTROLLER, OPTIMIZER, REGULATOR, SENSOR)
    common = [*COMMON, "-r", "__ns:=/left", *files(session, *inside)]
    assert told(session) == {COMPOSED: ["--record", *common]}


def test_a_recorder_apart_and_none(make: Callable[..., Session]) -> None:
    session = make(composed=True, separate_recorder=True)
    assert told(session) == {
        COMPOSED: [*COMMON, *files(session, *ALL[1:])],
        RECORDER: [*COMMON, *files(session, RECORDER)],
    }
    (session.directory.path / "logs" / f"{RECORDER}.log").unlink()
    assert set(told(make(composed=True, record=False))) == {COMPOSED}


@pytest.mark.parametrize(
    ("interactive", "namespace", "topics"),
    [
        (False, "/", [".*"]),
        (
            True,
            "/left",
            ["/left/.*", "/diagnostics", "/clock", "/rosout", "/tf", "/tf_static"],
        ),
    ],
)
def test_parameters_are_those_of_the_scenario_and_of_the_run(
    make: Callable[..., Session], interactive: bool, namespace: str, topics: list[str]
) -> None:
    session = make(interactive=interactive, namespace=namespace)
    told(session)
    folder = session.directory.path / "parameters"

    def parameters(name: str) -> dict[str, Any]:
        (content,) = yaml.safe_load((folder / f"{name}.yaml").read_text()).values()
        found: dict[str, Any] = content["ros__parameters"]
        return found

    plant, recorder = parameters(PLANT), parameters(RECORDER)
    assert plant["autostart"] is False and plant["rate"] == 250.0
    assert plant["duration"] == (0.0 if interactive else 0.1)
    assert recorder["topics"] == topics and recorder["output"] == str(session.directory.bag)
    assert recorder["scenario"] == session.directory.scenario.read_text()


@pytest.mark.parametrize(
    ("error", "failure", "interrupted"),
    [
        (Interrupted("ended by SIGINT"), "", True),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device", False),
    ],
)
def test_a_run_ends_by_a_signal_or_with_a_reason(
    make: Callable[..., Session], error: Exception, failure: str, interrupted: bool
) -> None:
    session = make(composed=True)
    told(session, error)
    assert failure in session.outcome.failure and bool(session.outcome.failure) == bool(failure)
    assert session.outcome.interrupted == interrupted


def missing(count: int) -> Callable[[], Iterator[Gap]]:
    return lambda: iter([Gap(PLANT if i else SENSOR, f"gap {i}") for i in range(count)])


@pytest.mark.parametrize(
    ("count", "shown"),
    [
        (1, "gap 0"),
        (6, "gap 0; gap 1; gap 2; gap 3; gap 4; gap 5"),
        (7, "gap 0; gap 1; gap 2; gap 3; gap 4; gap 5; and 1 more"),
        (8, "gap 0; gap 1; gap 2; gap 3; gap 4; gap 5; and 2 more"),
    ],
)
def test_what_is_missing_after_the_deadline_is_named_by_node(
    make: Callable[..., Session], count: int, shown: str
) -> None:
    session = make(startup_timeout=0.0)
    with pytest.raises(StartupError) as caught:
        session._await_graph(missing(count))
    logs = session.directory.path / "logs"
    silent = [f"{SENSOR} has not said anything", f"{PLANT} has not said anything"]
    assert str(caught.value).split("\n") == [
        f"the graph is not complete after 0 s: {shown}; look at {logs}",
        *silent[: min(count, 2)],
    ]
    assert "graph_matched" not in session.outcome.startup


def test_a_graph_is_awaited_until_nothing_is_missing(make: Callable[..., Session]) -> None:
    session, asked = make(), [3]

    def ever_less() -> Iterator[Gap]:
        asked[0] -= 1
        return missing(asked[0])()

    waits: list[float] = []
    session.signals.wait = waits.append  # type: ignore[method-assign]
    session._await_graph(ever_less)
    assert waits == [0.03, 0.03] and asked == [0] and "graph_matched" in session.outcome.startup


class Hand:
    """Stands in for the monitor of a hand that answers these ticks, one a look."""

    def __init__(self, *answered: int, faults: tuple[str, ...] = ()) -> None:
        self._answered, self._faults = list(answered), faults
        self.tick = -1

    def answered(self) -> int:
        if self._answered:
            self.tick = self._answered.pop(0)
        return self.tick

    def faults(self) -> list[str]:
        return list(self._faults)

    def look(self) -> Look:
        return Look(1e-9 * self.tick, 0.25, 7.0)


class Shown(Silence):
    """A view that keeps what it is to show."""

    def __init__(self, period: float) -> None:
        self.period = period
        self.seen: list[tuple[float, float, str]] = []

    def show(self, look: Look, rate: float, fault: str) -> None:
        self.seen.append((look.time, rate, fault))


def watch(session: Session, hand: Hand, view: Silence, *forces: UserForceConfig) -> list[float]:
    sent: list[float] = []
    asking = UserForces(forces, lambda request: sent.append(request.force))
    session._watch(hand, view, asking)  # type: ignore[arg-type]
    return sent


def test_a_run_is_watched_to_its_last_tick(make: Callable[..., Session]) -> None:
    session, view = make(), Shown(0.0)
    forces = [UserForceConfig(time=t, force=f) for t, f in ((0.05, 2.0), (0.1, 3.0), (0.2, 4.0))]
    hand = Hand(-1, 0, 50_000_000, 96_000_000, 100_000_000, 200_000_000, faults=("a", "b"))
    assert watch(session, hand, view, *forces) == [2.0, 3.0]
    outcome = session.outcome
    assert (outcome.last_tick, outcome.position_error) == (100_000_000, 0.25)
    assert list(outcome.startup) == ["checked", "first_tick_answered"]
    assert [time for time, _, _ in view.seen] == pytest.approx([-1e-9, 0.0, 0.05, 0.096, 0.1])
    assert {fault for *_, fault in view.seen} == {"a"}
    assert view.seen[-1][1] > 0.0


def test_a_view_is_shown_no_more_often_than_it_wants(make: Callable[..., Session]) -> None:
    view = Shown(60.0)
    watch(make(), Hand(0, 50_000_000, 100_000_000), view)
    assert [fault for *_, fault in view.seen] == [""]


@pytest.mark.parametrize(
    ("tick", "where", "faults", "said"),
    [
        (-1, "the start", (), "no node reports a fault"),
        (0, "t = 0 s", ("x: y", "z"), "x: y; z"),
        (4_000_000, "t = 0.004 s", ("x: y",), "x: y"),
    ],
)
def test_a_run_without_answers_is_given_up_after_fifteen_seconds(
    make: Callable[..., Session],
    monkeypatch: pytest.MonkeyPatch,
    tick: int,
    where: str,
    faults: tuple[str, ...],
    said: str,
) -> None:
    now = [0.0, 100.0, 100.0, 115.0, 115.1]  # at the tick, and at each look behind it
    hand = Hand(*[tick] * 9, faults=faults)
    times = iter([now[1], *now[2:]])
    monkeypatch.setattr(session_module, "time", SimpleNamespace(monotonic=lambda: next(times)))
    text = f"no tick was answered for 15 s since {where}: {said}; look at the logs"
    with pytest.raises(StallError, match=re.escape(text)):
        watch(make(interactive=True), hand, Silence())
    assert list(times) == []  # at 15 s it was not too late


def test_a_process_that_dies_ends_the_watch(
    make: Callable[..., Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = make()
    with session._processes as processes:
        monkeypatch.setattr(Shells, "command", lambda *_: ["/bin/sh", "-c", "exit 4"])
        processes.start(PLANT, session.directory.log(PLANT))
        with pytest.raises(NodeDiedError, match="plant ended with code 4"):
            wait_until(lambda: session._check())
        with pytest.raises(NodeDiedError):
            watch(session, Hand(), Silence())
        with pytest.raises(NodeDiedError):
            session._await_graph(missing(1))


def test_a_run_ends_with_the_tick_at_its_duration_or_never() -> None:
    assert Plan(SCENARIO).end == 100_000_000
    assert Plan(SCENARIO, interactive=True).end is None


@pytest.mark.parametrize(
    ("composed", "apart", "plant", "recorder"),
    [
        (False, False, PLANT, RECORDER),
        (False, True, PLANT, RECORDER),
        (True, False, COMPOSED, COMPOSED),
        (True, True, COMPOSED, RECORDER),
    ],
)
def test_nodes_share_a_process_the_recorder_on_demand(
    composed: bool, apart: bool, plant: str, recorder: str
) -> None:
    plan = Plan(SCENARIO, composed=composed, separate_recorder=apart)
    assert (plan.process(PLANT), plan.process(RECORDER)) == (plant, recorder)


def test_the_recorder_ends_last() -> None:
    assert STOP_ORDER[-1] == (RECORDER,) and PLANT in STOP_ORDER[0]


@pytest.mark.parametrize(
    ("failure", "interrupted", "complete"),
    [("", False, True), ("broken", False, False), ("", True, False), ("broken", True, False)],
)
def test_a_run_is_complete_without_failure_and_signal(
    failure: str, interrupted: bool, complete: bool
) -> None:
    outcome = RunOutcome(failure=failure, interrupted=interrupted)
    assert outcome.is_complete == complete
    assert outcome.last_tick == -1 and outcome.position_error != outcome.position_error
    outcome.done("checked")
    assert 0.0 < outcome.startup["checked"] == round(outcome.startup["checked"], 3)


def test_one_run_has_a_domain_and_namespace_until_it_ends() -> None:
    place = "/claimed_by_a_test"
    with claim(231, place):
        with claim(230, place), claim(231, f"{place}/too"):
            expected = f"in ROS domain 231 and namespace '{place}'"
            with pytest.raises(ClaimedError, match=re.escape(expected)):
                claim(231, place)
    claim(231, place).close()


def test_a_second_signal_makes_it_less_patient(make: Callable[..., Session]) -> None:
    session = make()
    for count, hurries in ((0, False), (1, False), (2, True)):
        session.signals.count = count
        assert session._processes._in_a_hurry() is hurries
