# SPDX-License-Identifier: Apache-2.0
"""When the plant moves on, waits, repeats itself, holds and ends: a real node, its clock set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.nodes.plant import driver as driver_module
from tactile_hand_ros.nodes.plant.driver import CONFLICT
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR, OK, WARN
from tactile_hand_ros.ros.endpoints import subscribe_directly, taken
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.ros.ticks import SenderCheck

TICK = 2_000_000
GENTLE, OTHER = np.full(9, 0.01), np.full(9, 0.02)


class Rig:
    """A plant that nothing spins, on a clock that the test sets."""

    def __init__(self, context: Any, clock: SimpleNamespace, **parameters: Any) -> None:
        self.clock = clock
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.node = PlantNode(context=context, parameter_overrides=overrides)
        self.driver = self.node._driver
        self.driver._senders = SenderCheck(lambda: clock.now)
        self.reports = 0
        self.node.publish_diagnostics = self._count_report  # type: ignore[method-assign]

    def _count_report(self) -> None:
        self.reports += 1

    def values(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        self.driver.report(found.__setitem__)
        return found

    def status(self) -> tuple[bytes, str]:
        status = self.node.diagnostics.status()
        return status.level, status.message

    def answer(self, stamp: int, torque: Any = GENTLE, number: int | None = None) -> None:
        self.driver.command(stamp, torque, {"publication_sequence_number": number})

    def state(self) -> tuple[str, int]:
        """Return the mode and the present tick."""
        return self.driver.mode, self.node._run.stamp // TICK

    def follows_the_clock(self) -> bool:
        return not self.driver._pacer.is_canceled()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    set_by_test = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(driver_module, "time", SimpleNamespace(monotonic=lambda: set_by_test.now))
    return set_by_test


@pytest.fixture
def make(clock: SimpleNamespace) -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []
    with isolated_domain() as domain, private_context(domain) as context:

        def _make(**parameters: Any) -> Rig:
            made.append(Rig(context, clock, **parameters))
            return made[-1]

        yield _make
        for rig in made:
            rig.node.close()
            rig.node.destroy_node()


def test_in_lockstep_each_answer_is_a_tick(make: Callable[..., Rig], clock: Any) -> None:
    rig = make()
    start = rig.values()
    assert (start["mode"], start["tick_ns"], start["answered_ns"]) == ("running", 0, -1)
    assert (start["finished"], start["time_s"], start["resent_ticks"]) == (False, 0.0, 0)
    clock.now += 0.0015
    rig.answer(0)
    assert rig.reports == 1  # the orchestrator waits for the first answer
    clock.now += 0.0005
    rig.answer(TICK)
    assert rig.reports == 1 and rig.state() == ("running", 2) and not rig.follows_the_clock()
    now = rig.values()
    assert (now["tick_ns"], now["answered_ns"], now["time_s"]) == (2 * TICK, TICK, 0.004)
    facts = {pair.key: pair.value for pair in rig.node.diagnostics.status().values}
    assert (facts["latency_p50_us"], facts["latency_max_us"]) == ("500", "1500")
    assert facts["ticks"] == "3"  # with the first, which was published before its answer


def test_what_comes_too_early_too_late_or_twice_changes_nothing(make: Callable[..., Rig]) -> None:
    rig = make()
    for stamp in (-TICK, TICK, -1):
        rig.answer(stamp)
    assert rig.state() == ("running", 0) and rig.values()["answered_ns"] == -1
    rig.answer(0)
    rig.answer(0)
    assert rig.state() == ("running", 1)
    assert rig.values()["answered_ns"] == 0 and rig.values()["conflicting_commands"] == 0


def test_a_paused_plant_takes_no_commands_and_reports_the_answer_to_its_last_tick(
    make: Callable[..., Rig],
) -> None:
    rig = make(autostart=False)
    rig.answer(0)
    assert rig.state() == ("paused", 0) and rig.reports == 1
    assert rig.driver.switch(True) and rig.reports == 2
    assert rig.driver.switch(True) and rig.reports == 2  # it is on
    rig.answer(0)
    rig.answer(TICK)
    assert rig.state() == ("running", 2) and rig.reports == 2
    assert rig.driver.switch(False) and rig.reports == 3
    rig.answer(2 * TICK)  # too late for the pause, but the bag is complete
    assert rig.state() == ("paused", 2) and rig.reports == 4
    assert rig.values()["answered_ns"] == 2 * TICK


def test_a_run_ends_at_its_duration_and_starts_again_with_a_reset(
    make: Callable[..., Rig],
) -> None:
    rig = make(duration=0.004)
    for tick in range(4):
        rig.answer(tick * TICK)
    assert rig.state() == ("finished", 2) and rig.values()["finished"] is True
    assert rig.status() == (OK, "finished at 0.004 s")
    assert not rig.driver.switch(True)
    assert rig.driver.switch(False) and rig.state() == ("finished", 2)
    rig.driver.reset()
    assert rig.state() == ("paused", 0) and rig.values()["answered_ns"] == -1
    assert rig.driver.switch(True)
    rig.answer(0)
    assert rig.state() == ("running", 1) and rig.status()[1] == "running"


def test_a_tick_without_an_answer_is_sent_again_as_it_was(
    make: Callable[..., Rig], clock: Any
) -> None:
    rig = make(resend_after=0.25, command_timeout=30.0)
    told = subscribe_directly(rig.node, JointState, "joint_states", QoSProfile(depth=10))
    wait_until(lambda: rig.driver._topics._joints_publisher.get_subscription_count() == 1)
    rig.answer(0)
    (first, _), *_ = wait_until(lambda: list(taken(told)))
    clock.now += 0.2499
    rig.driver._on_watch()
    assert rig.values()["resent_ticks"] == 0
    clock.now += 0.0002
    rig.driver._on_watch()
    rig.driver._on_watch()
    assert rig.values()["resent_ticks"] == 1
    ((again, _),) = wait_until(lambda: list(taken(told)))
    assert again == first and header_stamp(first) == TICK
    clock.now += 0.2501
    rig.driver._on_watch()
    assert rig.values()["resent_ticks"] == 2


def test_a_long_silence_holds_the_joints_while_time_continues(
    make: Callable[..., Rig], clock: Any
) -> None:
    rig = make(command_timeout=2.0, resend_after=0.5)
    rig.answer(0)
    clock.now += 1.9999
    rig.driver._on_watch()
    assert rig.state() == ("running", 1) and not rig.follows_the_clock()
    clock.now += 0.0002
    rig.driver._on_watch()
    assert rig.state() == ("holding", 1) and rig.follows_the_clock()
    resent = rig.values()["resent_ticks"]
    rig.driver._pace.due = lambda: 2  # type: ignore[method-assign]
    rig.driver._on_pace()
    assert rig.state() == ("holding", 3) and rig.values()["held_ticks"] == 2
    reason = "no usable joint_command for 2 s, expected one for each tick"
    assert rig.values()[f"holds: {reason}"] == 1
    assert rig.status() == (ERROR, f"{reason}; the joints are held")
    clock.now += 9.0
    rig.driver._on_watch()
    assert rig.values()["resent_ticks"] == resent  # ticks go on by themselves
    rig.answer(TICK)  # the controller is back: time waits for it again
    assert rig.driver._run.stamp == 3 * TICK and not rig.follows_the_clock()
    rig.answer(3 * TICK)
    assert rig.state()[1] == 4 and rig.driver.mode == "running"


def test_before_the_first_command_a_silence_only_warns(
    make: Callable[..., Rig], clock: Any
) -> None:
    rig = make(command_timeout=2.0)
    clock.now += 2.0
    rig.driver._on_watch()
    assert rig.state() == ("running", 0) and not rig.follows_the_clock()
    text = "no usable joint_command for 2 s, waiting at the first tick"
    assert rig.status() == (WARN, text)
    rig.answer(0)
    assert rig.status()[0] == OK


def test_two_senders_are_both_refused_until_half_a_second_is_over(
    make: Callable[..., Rig], clock: Any
) -> None:
    rig = make()
    rig.answer(0, GENTLE, 8)
    rig.answer(0, OTHER, 1)  # it may be a successor
    assert rig.state() == ("running", 1)
    rig.answer(0, GENTLE, 9)
    rig.answer(0, OTHER, 2)
    assert rig.state() == ("holding", 1) and rig.follows_the_clock()
    assert rig.values()["conflicting_commands"] == 1
    rig.answer(TICK, GENTLE, 10)
    assert rig.state() == ("holding", 1)
    rig.driver._advance(1)
    assert rig.status() == (ERROR, f"{CONFLICT}; the joints are held")
    clock.now += 0.49
    rig.driver._on_watch()
    assert rig.state() == ("holding", 2) and rig.follows_the_clock() and rig.node._run.refusing
    clock.now += 0.02
    rig.driver._on_watch()
    assert not rig.follows_the_clock() and not rig.node._run.refusing
    rig.answer(2 * TICK, GENTLE)
    assert rig.state() == ("running", 3)


def test_an_error_that_was_not_foreseen_holds_only_joints_that_were_commanded(
    make: Callable[..., Rig],
) -> None:
    rig = make()
    rig.driver.to_safe_state("KeyError")
    assert rig.state() == ("running", 0)
    rig.answer(0)
    rig.driver.switch(False)
    rig.driver.to_safe_state("KeyError")
    assert rig.state() == ("paused", 1)
    rig.driver.switch(True)
    rig.driver.to_safe_state("KeyError")
    assert rig.state() == ("holding", 1)
    assert rig.status() == (ERROR, "KeyError; the joints are held")
    rig.driver.to_safe_state("another")
    assert rig.status() == (ERROR, "KeyError; the joints are held")


def test_a_simulation_that_diverges_stands_still_until_a_reset(make: Callable[..., Rig]) -> None:
    rig = make()

    def fail() -> None:
        raise DivergedError("the state is not finite")

    healthy, rig.node._run.advance = rig.node._run.advance, fail  # type: ignore[method-assign]
    rig.answer(0)
    assert rig.driver.mode == "paused" and not rig.follows_the_clock()
    assert rig.status() == (ERROR, "the state is not finite (~/reset, then ~/run)")
    rig.node._run.advance = healthy  # type: ignore[method-assign]
    rig.driver.reset()
    assert rig.driver.switch(True) and rig.status()[0] == OK
    rig.answer(0)
    assert rig.state() == ("running", 1)


def test_in_real_time_the_first_command_starts_the_clock(make: Callable[..., Rig]) -> None:
    rig = make(pacing="realtime", duration=0.01)
    assert not rig.follows_the_clock()
    rig.answer(0)
    assert rig.follows_the_clock() and rig.state() == ("running", 0)
    due = [0]
    rig.driver._pace.due = lambda: due[0]  # type: ignore[method-assign]
    rig.driver._on_pace()
    assert rig.state() == ("running", 0)
    due[0] = 3
    rig.driver._on_pace()
    assert rig.state() == ("running", 3)
    rig.driver._on_pace()
    assert rig.state() == ("finished", 5) and not rig.follows_the_clock()


@pytest.mark.parametrize(("ticks", "taken_up"), [(3, True), (4, False)])
def test_in_real_time_a_command_may_be_as_old_as_the_guard_allows(
    make: Callable[..., Rig], clock: Any, ticks: int, taken_up: bool
) -> None:
    rig = make(**{"pacing": "realtime", "guard.age_limit": 3})
    rig.answer(0)
    rig.driver._advance(ticks + 1)
    clock.now += 0.25
    rig.answer(TICK, OTHER)
    assert rig.values()["too_old_commands"] == int(not taken_up)
    facts = {pair.key: pair.value for pair in rig.node.diagnostics.status().values}
    assert (facts["latency_max_us"] == f"{250_000 + 2000 * ticks}") == taken_up


def test_in_real_time_an_answer_counts_once_and_none_before_the_newest(
    make: Callable[..., Rig],
) -> None:
    rig = make(pacing="realtime")
    rig.answer(0)
    rig.driver._advance(2)
    for stamp in (2 * TICK, 2 * TICK, TICK):
        rig.answer(stamp)
    assert rig.values()["too_old_commands"] == 0
    assert rig.node._run._command is not None and rig.node._run._command.stamp == 2 * TICK


def test_that_the_joints_are_held_is_published_at_each_change_and_reported_ten_times_a_second(
    make: Callable[..., Rig], clock: Any
) -> None:
    rig = make(**{"pacing": "realtime", "guard.age_limit": 1})
    held = subscribe_directly(rig.node, Bool, "joint_hold", qos.latched_qos(10))
    (first, _), *_ = wait_until(lambda: list(taken(held)))
    rig.answer(0)
    rig.driver._advance(2)
    assert rig.state() == ("running", 2) and list(taken(held)) == []
    told = rig.reports
    rig.driver._advance(1)
    assert rig.state() == ("holding", 3) and rig.reports == told + 1
    ((second, _),) = wait_until(lambda: list(taken(held)))
    assert (bool(first[4]), bool(second[4])) == (False, True)
    rig.answer(3 * TICK)
    clock.now += 0.09
    rig.driver._advance(1)
    assert rig.driver.mode == "running" and rig.reports == told + 1  # not again so soon
    clock.now += 0.02
    rig.answer(4 * TICK)
    rig.driver._advance(1)
    assert rig.reports == told + 2 and rig.status()[0] == OK


def test_a_running_plant_publishes_its_first_tick_again_at_a_reset(
    make: Callable[..., Rig],
) -> None:
    rig, sent = make(), list[int]()
    rig.answer(0)
    rig.answer(TICK)
    told, rig.driver._topics.publish = rig.reports, lambda stamp, *_: sent.append(stamp)  # type: ignore[method-assign]
    rig.driver.reset()
    assert sent == [0] and rig.reports == told + 1 and rig.state() == ("running", 0)
    rig.answer(0, OTHER)  # no conflict with what was answered before
    assert sent == [0, TICK] and rig.values()["conflicting_commands"] == 0
