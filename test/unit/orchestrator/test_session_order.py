# SPDX-License-Identifier: Apache-2.0
"""The order of a run: meet, command, go, watch, pause, and wait for the last answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from tactile_hand_ros.names import PLANT
from tactile_hand_ros.orchestrator import session as module
from tactile_hand_ros.orchestrator.processes import NodeDiedError
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome, Session, StallError, _gaps
from tactile_hand_ros.orchestrator.steering import SteeringError
from tactile_hand_ros.orchestrator.view import Silence
from tactile_hand_ros.orchestrator.wiring import Gap
from tactile_hand_ros.scenario.scenario import load_scenario


class Rig:
    """A session without processes, whose parts note what is asked of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **plan: Any) -> None:
        self.calls: list[Any] = []
        self.rest_after, self.fails = 3, {}
        self.now = 100.0
        self.session = Session.__new__(Session)
        self.session.plan = Plan(load_scenario("paper"), **plan)
        self.session.outcome = RunOutcome()
        self.session._processes = SimpleNamespace(check=self._note("alive"))  # type: ignore[assignment]
        self.session.signals = SimpleNamespace(check=self._note("signals"))  # type: ignore[assignment]
        for name in ("_await_graph", "_watch"):
            monkeypatch.setattr(self.session, name, self._note(name))
        steering = SimpleNamespace(
            command=self._note("command"), run=self._note("run"), squeeze=None
        )
        for name, part in (
            ("Steering", steering),
            ("Monitor", self),
            ("Wiring", SimpleNamespace()),
            ("UserForces", SimpleNamespace(step=self._note("forces"), is_due_later=False)),
        ):
            monkeypatch.setattr(module, name, self._made(name, part))
        self.made: dict[str, Any] = {}
        monkeypatch.setattr(module, "pause", self._pause)
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: self.now))

    def _made(self, name: str, part: Any) -> Callable[..., Any]:
        def make(*args: Any, **options: Any) -> Any:
            self.made[name] = options
            return part

        return make

    def _note(self, name: str) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> None:
            own = [a for a in args if isinstance(a, bool | int | float)]
            self.calls.append((name, *own, *options.items()))
            key = (name, *own)
            if key in self.fails:
                raise self.fails[key]

        return call

    def _pause(self, seconds: float) -> None:
        self.now += seconds
        self.calls.append(("pause", seconds))

    @property
    def is_at_rest(self) -> bool:
        self.rest_after -= 1
        return self.rest_after <= 0

    def plant_facts(self) -> dict[str, str]:
        return {"mode": "paused"}

    def conduct(self) -> list[Any]:
        node: Any = SimpleNamespace()
        self.session._conduct(node, SimpleNamespace())  # type: ignore[arg-type]
        return self.calls


REST = [("run", False, ("timeout", 1.0), ("check", False))]
LOOK = [("alive",), ("pause", 0.02)]


def test_a_run_is_conducted_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    assert rig.conduct() == [
        *(("_await_graph",), ("command",), ("forces", 0), ("run", True), ("_watch",)),
        *REST,
        *LOOK * 2,
        ("pause", 0.3),
    ]
    assert rig.made["Monitor"] == {"closely": False} and rig.made["Wiring"] == {"recorded": True}
    assert rig.session.outcome.plant == {"mode": "paused"}
    assert list(rig.session.outcome.startup) == ["targets_sent"]


@pytest.mark.parametrize(("record", "later"), [(False, False), (True, True), (False, True)])
def test_it_is_watched_closely_where_nothing_else_tells(
    monkeypatch: pytest.MonkeyPatch, record: bool, later: bool
) -> None:
    rig = Rig(monkeypatch, record=record)
    forces = SimpleNamespace(step=lambda _: None, is_due_later=later)
    monkeypatch.setattr(module, "UserForces", lambda *_: forces)
    rig.conduct()
    assert rig.made["Monitor"] == {"closely": True} and rig.made["Wiring"] == {"recorded": record}


def test_a_run_that_fails_comes_to_rest_too(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    rig.fails = {("_watch",): StallError("no answer"), ("run", False): SteeringError("no plant")}
    with pytest.raises(StallError):
        rig.conduct()
    assert rig.calls[-6:] == [*REST, *LOOK * 2, ("pause", 0.3)]
    assert rig.session.outcome.plant == {"mode": "paused"}


def test_it_waits_a_second_for_the_last_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    rig.rest_after = 1000
    assert rig.conduct().count(("pause", 0.02)) in (50, 51)


def test_a_node_that_has_died_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    rig.fails = {("alive",): NodeDiedError("plant ended")}
    assert rig.conduct()[-2:] == [("alive",), ("pause", 0.3)]
    assert rig.session.outcome.plant == {"mode": "paused"}


@pytest.mark.parametrize("ready", [True, False])
def test_the_service_of_the_plant_is_missing_until_it_answers(ready: bool) -> None:
    asked: list[Any] = []
    gap = Gap(PLANT, "not there")
    node: Any = SimpleNamespace(get_fully_qualified_name=lambda: "/orchestrator")
    wiring: Any = SimpleNamespace(missing=lambda facts: asked.append(facts) or iter([gap]))
    monitor: Any = SimpleNamespace(facts=lambda: {"/plant": {"a": "1"}})
    steering: Any = SimpleNamespace(is_ready=ready, facts={"b": "2"})
    service = Gap(PLANT, "the service of the plant does not answer yet")
    expected = [gap] if ready else [gap, service]
    assert list(_gaps(node, wiring, monitor, steering)) == expected
    assert asked == [{"/plant": {"a": "1"}, "/orchestrator": {"b": "2"}}]


def test_signals_and_processes_are_checked_while_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    rig.session._check()
    assert rig.calls == [("signals",), ("alive",)]


def test_the_first_answer_is_looked_for_more_often_than_the_next_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What comes between the two is the time to the first tick."""
    rig, waits = Rig(monkeypatch), list[float]()
    monkeypatch.undo()
    rig.session.signals = SimpleNamespace(wait=waits.append)  # type: ignore[assignment]
    end = rig.session.plan.end
    ticks = [-1, -1, 0, 5, end, end]
    look = SimpleNamespace(position_error=0.5)
    monitor: Any = SimpleNamespace(answered=lambda: ticks.pop(0), look=lambda: look)
    asking: Any = SimpleNamespace(step=lambda _: None)
    view = Silence()
    monkeypatch.setattr(view, "period", math.inf)
    monitor.faults = list
    rig.session._watch(monitor, view, asking)
    assert waits == [0.002, 0.002, 0.002, 0.02, 0.02]
    assert ticks == [end] and rig.session.outcome.position_error == 0.5
