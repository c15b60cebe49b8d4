# SPDX-License-Identifier: Apache-2.0
"""When the plant advances, waits, repeats, holds and ends: over DDS, with a test clock."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from support.messages import stamp_to_ns
from support.nodes import Process, counts, facts

from tactile_hand_ros import names
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.plant import driver as driver_module
from tactile_hand_ros.nodes.plant.driver import CONFLICT
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR, WARN
from tactile_hand_ros.ros.messages import JointCodec
from tactile_hand_ros.simulation.plant_run import PlantRun

COMMAND = JointCodec(Hand.load("paper").joint_names, ("effort",))


class Rig:
    """A plant on a test clock, and two command senders."""

    def __init__(self, here: Process, clock: SimpleNamespace, **parameters: Any) -> None:
        self.here, self.clock = here, clock
        self.node = here.make(PlantNode, composed=False, **parameters)
        for kind, topic, profile in (
            (JointState, names.JOINT_STATES, qos.TICK_DEPTH),
            (Bool, names.JOINT_HOLD, qos.latched_qos(10)),
            (DiagnosticArray, names.DIAGNOSTICS, qos.USER_DEPTH),
        ):
            here.receive(kind, topic, profile)
        make = here.user.create_publisher
        self._senders = [make(JointState, names.JOINT_COMMAND, qos.TICK_DEPTH) for _ in "ab"]
        here.wait(lambda: self.node.peers()["subscriptions /joint_command"] == 2, "commands")
        for topic in ("joint_states", "joint_hold"):
            here.wait(lambda t=topic: self.node.peers()[f"publications /{t}"] == 1, topic)
        here.wait(lambda: all(s.get_subscription_count() for s in self._senders), "the plant")

    def send(self, *ticks: int, sender: int = 0) -> None:
        for tick in ticks:
            stamp = tick * self.node.config.tick
            self._senders[sender].publish(COMMAND.encode(stamp, np.full(9, 0.01)))

    def until(self, mode: str, tick: int | None = None, **values: object) -> dict[str, str]:
        """Wait for a mode, a tick and other facts."""
        expected = {"mode": mode, **{key: str(value) for key, value in values.items()}}
        if tick is not None:
            expected["tick_ns"] = str(tick * self.node.config.tick)
        self.here.wait(lambda: expected.items() <= facts(self.node).items(), str(expected))
        return facts(self.node)

    def answer(self, *ticks: int, mode: str = "running") -> dict[str, str]:
        """Send commands for ticks in lockstep and wait for the tick after the last one."""
        self.send(*ticks)
        return self.until(mode, ticks[-1] + 1)

    def switch(self, on: bool) -> Any:
        return self.here.call(SetBool, "plant/run", data=on)

    def reset(self) -> Any:
        return self.here.call(Trigger, "plant/reset")

    def says(self, level: bytes, text: str) -> None:
        """Wait for a diagnostic state."""

        def said() -> bool:
            status = self.node.diagnostics.status()
            return bool((status.level, status.message) == (level, text))

        self.here.wait(said, text)

    @property
    def now(self) -> int:
        return int(facts(self.node)["tick_ns"]) // self.node.config.tick

    def returns(self) -> None:
        """Command each present tick until the plant runs without a complaint."""

        def runs() -> bool:
            self.clock.now += 0.02
            self.send(self.now)
            found = facts(self.node)
            return found["mode"] == "running" and not any(key.startswith("fault") for key in found)

        self.here.wait(runs, "the end of the hold")

    def held_ticks(self, more: int = 3) -> None:
        """Wait for ticks of a hold."""
        last = int(facts(self.node)["held_ticks"])
        self.here.wait(lambda: int(facts(self.node)["held_ticks"]) > last + more, "held ticks")

    def ticks(self) -> list[int]:
        found = self.here.messages(names.JOINT_STATES, 0)
        return [stamp_to_ns(m.header.stamp) // self.node.config.tick for m in found]


@pytest.fixture
def make(here: Process, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Rig]:
    clock = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(driver_module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return lambda **parameters: Rig(here, clock, **parameters)


def test_in_lockstep_each_answer_is_a_tick_and_other_commands_change_nothing(make):
    rig = make()
    start = rig.until("running", 0, answered_ns=-1, resent_ticks=0, finished=False)
    assert start["time_s"] == "0"
    rig.clock.now += 0.0015
    rig.send(3, 1)  # too early
    rig.answer(0)
    rig.clock.now += 0.0005
    rig.send(0, 0)  # answered already
    now = rig.answer(1)
    assert (now["answered_ns"], now["time_s"]) == ("2000000", "0.004")
    assert now["conflicting_commands"] == "0"
    assert (now["latency_p50_us"], now["latency_max_us"]) == ("500", "1500")
    assert now["ticks"] == "3"  # including the first, which was published before its answer
    assert rig.ticks()[-2:] == [1, 2]
    rig.send(2, 3)
    rig.until("running", 4)
    told = [s for m in rig.here.messages(names.DIAGNOSTICS, 1) for s in m.status]
    facts_told = {(pair.key, pair.value) for status in told for pair in status.values}
    assert ("answered_ns", "0") in facts_told  # the orchestrator waits for the first answer


def test_a_paused_plant_takes_no_commands_and_reports_the_answer_to_its_last_tick(make):
    rig = make(autostart=False)
    rig.send(0)
    rig.until("paused", 0, answered_ns=0)
    for _ in range(2):  # the second call has no effect
        answer = rig.switch(True)
        assert (answer.success, answer.message) == (True, "running")
    rig.answer(0, 1)
    assert rig.switch(False).message == "paused"
    rig.send(2)  # too late for the pause, but the bag is complete
    rig.until("paused", 2, answered_ns=4_000_000)


def test_a_run_ends_at_its_duration_and_starts_again_with_a_reset(make):
    rig = make(duration=0.004)
    rig.send(0, 1, 2, 3)
    rig.until("finished", 2, finished=True)
    assert facts(rig.node)["fault state"] == "finished at 0.004 s"
    assert not rig.switch(True).success and rig.switch(False).message == "finished"
    answer = rig.reset()
    assert (answer.success, answer.message) == (True, "paused")
    rig.until("paused", 0, answered_ns=-1)
    assert rig.switch(True).success
    assert "fault state" not in rig.answer(0)


def test_a_running_plant_publishes_its_first_tick_again_at_a_reset(make):
    rig = make()
    rig.answer(0, 1)
    rig.here.wait(lambda: 2 in rig.ticks())
    assert rig.reset().message == "running" and facts(rig.node)["touching"] == "3"
    rig.here.wait(lambda: rig.ticks()[-1] == 0, "the first tick")
    rig.answer(0)


def test_a_tick_without_an_answer_is_sent_again_as_it_was_and_only_after_a_time(make):
    rig = make(resend_after=0.25, command_timeout=30.0)
    rig.answer(0)
    for wait, resent in ((0.2499, 0), (0.0002, 1), (0.2501, 2)):
        rig.clock.now += wait
        rig.until("running", 1, resent_ticks=resent)
    rig.here.wait(lambda: rig.ticks()[-3:] == [1, 1, 1], "two repeats")
    first, *others = rig.here.messages(names.JOINT_STATES, 0)[-3:]
    assert others == [first, first]


def test_a_long_silence_holds_the_joints_while_time_continues(make):
    rig = make(command_timeout=2.0, resend_after=0.5)
    rig.here.receive(Log, "/rosout")
    rig.answer(0)
    rig.clock.now += 2.0001
    reason = "no usable joint_command for 2 s, expected one for each tick"
    resent = rig.until("holding", **{f"holds: {reason}": 1})["resent_ticks"]
    rig.says(ERROR, f"{reason}; the joints are held")
    lines = rig.here.messages("/rosout", 1)
    assert f"running -> holding: {reason}" in [line.msg for line in lines]
    rig.clock.now += 9.0
    rig.held_ticks(100)
    assert facts(rig.node)["resent_ticks"] == resent  # ticks continue without commands
    rig.returns()  # the controller is back: the plant waits for it again
    rig.answer(rig.now)


def test_before_the_first_command_a_silence_only_warns(make):
    rig = make(command_timeout=2.0)
    rig.clock.now += 2.0
    text = "no usable joint_command for 2 s, waiting at the first tick"
    rig.says(WARN, text)
    rig.until("running", 0)
    assert "fault state" not in rig.answer(0)


def test_two_senders_are_both_refused_until_half_a_second_is_over(make):
    rig = make()
    rig.answer(0, 1, 2, 3)
    rig.send(4, sender=1)  # it may be a successor
    rig.until("running", 5)

    def disagree() -> bool:
        for sender in (0, 1):
            rig.send(rig.now, sender=sender)
        status = rig.node.diagnostics.status()
        return (status.level, status.message) == (ERROR, f"{CONFLICT}; the joints are held")

    rig.here.wait(disagree, "the conflict")
    assert int(facts(rig.node)["conflicting_commands"]) > 0
    rig.held_ticks()
    left = "no joint_command since there were two senders of it"
    rig.says(ERROR, f"{left}; the joints are held")
    rig.returns()


def test_an_error_that_was_not_foreseen_holds_only_joints_that_were_commanded(make):
    rig = make()
    rig.node.to_safe_state("KeyError")
    rig.until("running", 0)
    rig.answer(0)
    rig.switch(False)
    rig.node.to_safe_state("KeyError")
    rig.until("paused", 1)
    rig.switch(True)
    for reason in ("KeyError", "another"):
        rig.node.to_safe_state(reason)
        rig.until("holding")
        rig.says(ERROR, "KeyError; the joints are held")


def test_a_simulation_that_diverges_stands_still_until_a_reset(make, monkeypatch):
    rig = make()
    diverging = Mock(side_effect=DivergedError("the state is not finite"))
    with monkeypatch.context() as patch:
        patch.setattr(PlantRun, "advance", diverging)
        rig.send(0)
        rig.until("paused", 0)
        rig.says(ERROR, "the state is not finite (~/reset, then ~/run)")
    rig.reset()
    assert rig.switch(True).success
    assert "fault state" not in rig.answer(0)


def test_in_real_time_the_first_command_starts_the_clock(make):
    rig = make(pacing="realtime", duration=0.01, resend_after=0.1)
    rig.clock.now += 0.2
    rig.until("running", 0, resent_ticks=1)
    rig.send(0)
    rig.until("finished", 5)


def test_in_real_time_a_command_may_be_as_old_as_the_guard_allows(make):
    """An older command is ignored, and the resulting hold is published once."""
    rig = make(**{"pacing": "realtime", "guard.age_limit": 3, "rate": 100.0})
    # Only the last state is latched, so the first one must arrive before it changes.
    assert not rig.here.messages(names.JOINT_HOLD, 1)[0].data
    rig.send(0)
    rig.until("holding")
    rig.held_ticks(10)
    rig.send(rig.now - 8)
    rig.until("holding", too_old_commands=1)
    rig.held_ticks()
    assert [message.data for message in rig.here.messages(names.JOINT_HOLD, 2)] == [False, True]


def test_a_paused_plant_takes_single_steps(here: Process, make: Callable[..., Rig]) -> None:
    rig = make(autostart=False)
    assert here.call(Trigger, "plant/step").success
    rig.answer(0, mode="paused")
    assert rig.now == 1
    assert here.call(Trigger, "plant/step").success
    rig.answer(1, mode="paused")
    assert rig.switch(True).success
    refused = here.call(Trigger, "plant/step")
    assert (refused.success, refused.message) == (False, "the plant is not paused")


def test_a_step_in_real_time_is_one_tick_however_many_are_due(here, make) -> None:
    rig = make(pacing="realtime", autostart=False)
    rig.node._driver._pace.due = lambda: 3
    for tick in (1, 2):
        assert here.call(Trigger, "plant/step").success
        rig.send(tick - 1)
        rig.until("paused")
        assert rig.now == tick


def test_after_an_unanswered_step_the_plant_runs_without_end(here, make) -> None:
    rig = make(autostart=False)
    assert here.call(Trigger, "plant/step").success
    rig.switch(False)
    rig.switch(True)
    rig.answer(0, 1)


def test_a_step_at_the_last_tick_leaves_a_paused_plant_after_a_reset(here, make) -> None:
    rig = make(duration=0.002)
    rig.answer(0)
    rig.switch(False)
    assert here.call(Trigger, "plant/step").success
    rig.send(1)
    rig.until("finished", 1)
    assert rig.reset().message == "paused"
    rig.switch(True)
    rig.send(0, 1)
    rig.until("finished", 1)


def test_a_speed_holds_the_next_tick_back_until_it_is_due(make: Callable[..., Rig]) -> None:
    rig = make(speed=0.01)  # a tick in 200 ms
    brake, tick = rig.node._driver._brake, rig.node.config.tick
    brake._clock = lambda: round(1e9 * rig.clock.now)
    brake.set(0.01)
    rig.answer(0)
    for number, wait in ((1, 0.2), (2, 0.5)):  # an answered tick is not sent again
        rig.send(number)
        rig.until("running", number, answered_ns=number * tick)
        rig.clock.now += wait
        rig.until("running", number + 1)
    rig.answer(3)
    rig.send(4)
    rig.until("running", 4, answered_ns=4 * tick)
    rig.node.set_parameters([Parameter("speed", value=0.0)])
    for number in range(5, 20):
        rig.until("running", number)
        rig.send(number)
    assert facts(rig.node)["resent_ticks"] == "0"


def test_pushes_arrive_and_those_of_another_frame_are_rejected(here, make) -> None:
    rig = make()
    push = WrenchStamped()
    push.wrench.force.z = 2.0
    here.send(names.PUSH, push)
    here.wait(lambda: counts(rig.node, "rejected") == {"push": 1}, "the rejection")
    push.header.frame_id = "palm"
    push.wrench.torque.x = 0.5
    here.send(names.PUSH, push)
    plant = rig.node._run.plant
    here.wait(lambda: plant._push.tolist() == [0.0, 0.0, 2.0, 0.5, 0.0, 0.0], "the push")
    assert plant._push_end == pytest.approx(0.2 + plant.time)
