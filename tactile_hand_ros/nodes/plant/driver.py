# SPDX-License-Identifier: Apache-2.0
"""Timing of the plant's ticks: in lockstep with commands, or by the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, String

from tactile_hand_ros import names
from tactile_hand_ros.cdr import clock_bytes
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.common import ModeLog, ReadingPublisher, rotated_pose_encoder
from tactile_hand_ros.nodes.plant.real_time import Brake, Pace
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR, OK, WARN
from tactile_hand_ros.ros.messages import ImuCodec, JointCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import SenderCheck, two_senders
from tactile_hand_ros.simulation.plant import PlantState
from tactile_hand_ros.simulation.plant_config import PlantConfig
from tactile_hand_ros.simulation.plant_run import PlantRun


class InProcessHand(Protocol):
    """The blocks that answer the plant's ticks in its process."""

    def answer(self, stamp: int, state: PlantState) -> Array | None:
        """Return the torque for a tick, shape (m,), N m, or None if there is none."""

    def hold(self, held: bool) -> None:
        """Set whether the guard holds the joints."""

    def on_restart(self) -> None:
        """Start over after time was set back."""


CONFLICT = two_senders(names.JOINT_COMMAND)
_LEFT = f"no {names.JOINT_COMMAND} since there were two senders of it"

_TURN = 0.005
"""Time to run ticks before messages and services are served [s]."""


class PlantTopics:
    """Publishes the state of a plant, and once the URDF of its hand."""

    def __init__(self, node: TactileNode[Any], hand: Hand, *, turns: bool) -> None:
        """Create the publishers, with an IMU if the palm turns, and publish the URDF."""
        self._truth = ReadingPublisher(
            node, hand.finger_names, names.TRUE_CONTACTS, names.true_wrench
        )
        slip = JointCodec(hand.finger_names, ("position", "velocity")).encode
        self._slip_publisher = node.tick_publisher(JointState, names.TRUE_SLIP, slip)
        joints = JointCodec(hand.joint_names, ("position", "velocity", "effort")).encode
        self._joints_publisher = node.tick_publisher(JointState, names.JOINT_STATES, joints)
        imu = ImuCodec().encode
        self._imu_publisher = node.tick_publisher(Imu, names.IMU, imu) if turns else None
        self._awaited = tuple(node.tick_publishers)
        pose = rotated_pose_encoder()
        self._pose_publisher = node.tick_publisher(PoseStamped, names.OBJECT_POSE, pose)
        self._clock_publisher = node.tick_publisher(Clock, names.CLOCK, clock_bytes)
        latched = qos.latched_qos()
        self._description = node.create_publisher(String, names.ROBOT_DESCRIPTION, latched)
        self._description.publish(String(data=hand.description))
        self._hold = node.create_publisher(Bool, names.JOINT_HOLD, latched)
        self._is_held: bool | None = None

    def publish(self, stamp_ns: int, state: PlantState) -> None:
        """Publish a tick [ns]; start with the topics that nodes wait for."""
        self._slip_publisher.publish(stamp_ns, state.slid, state.speeds)
        self._truth.publish(stamp_ns, *state.touch)
        if self._imu_publisher is not None:
            self._imu_publisher.publish(state.palm, stamp_ns)
        self._joints_publisher.publish(stamp_ns, *state.joints)
        self._pose_publisher.publish(state.position, state.rotation, stamp_ns)
        self._clock_publisher.publish(stamp_ns)

    def publish_hold(self, is_held: bool) -> None:
        """Publish whether the joints are held, if that has changed."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._hold.publish(Bool(data=is_held))

    def repeat(self) -> None:
        """Publish again the topics that nodes wait for."""
        for publisher in self._awaited:
            publisher.repeat()


class PlantDriver:
    """Drives a run of the plant, by commands or by a hand in this process.

    The first tick waits for its command, because without one the hand would open and drop the
    object. The tick is sent again after each short silence. In lockstep every tick waits like this.
    After a long silence the joints are held and time follows the wall clock until a command comes.
    In real time the last command acts until a newer one comes, or until the guard finds it too old.
    While there are two senders, the joints are held.

    The answer of a `hand` in this process is the command of the tick. A missing one counts as
    silence of the controller.
    """

    def __init__(self, node: TactileNode[PlantConfig], run: PlantRun) -> None:
        """Create publishers and timers; `begin` starts the run."""
        self.hand: InProcessHand | None = None
        self._torque: Array | None = None  # the hand's answer to the current tick
        self._node = node
        self._diagnostics = node.diagnostics
        self._run = run
        self._config = c = node.config
        self._is_lockstep = c.pacing == "lockstep"
        self._is_on, self._is_finished = c.autostart, False
        self._resent = self._too_old = 0
        self._newest_answer = -1
        self._senders = SenderCheck()
        self._modes = ModeLog(node.get_logger().info)
        self._topics = PlantTopics(node, run.plant.hand, turns=bool(c.palm_motion))
        self._pace = Pace(c.tick)
        self._pacer = node.create_timer(1e-9 * c.tick, self._on_pace)
        self._pacer.timer_period_ns = c.tick
        self._brake = Brake(c.tick)
        self._is_answered = self._is_single = False
        self._braker = node.create_timer(1e-9 * c.tick, self._on_brake)
        self._braker.cancel()
        watch = 0.25 * min(c.resend_after, c.command_timeout)
        self._watcher = node.create_timer(watch, self._on_watch)

    @property
    def mode(self) -> str:
        """State of the plant: paused, running, holding or finished."""
        if self._is_finished:
            return "finished"
        if not self._is_on:
            return "paused"
        return "holding" if self._run.reason else "running"

    @property
    def _waits(self) -> bool:
        """Whether the current tick waits for its command."""
        return self._is_lockstep or not self._run.commanded

    def begin(self) -> None:
        """Publish the current tick and wait for its command; in real time, wait only for the first.

        Publish the diagnostics immediately, because the mode may have changed.
        """
        self._run.refused = ""
        self._publish_hold()
        self._is_answered = False
        self._diagnostics.clear("state")
        self._answered = self._run.stamp - self._config.tick
        self._answered_at = self._sent_at = time.monotonic()
        self._let_time_pass(self._is_on and not self._waits)
        if self._is_on:
            self._watcher.reset()
            self._publish()
        self._node.publish_diagnostics()

    def limit_speed(self, speed: float) -> None:
        """Limit the speed in lockstep, in simulated seconds per second; 0 for no limit."""
        if not self._is_lockstep or speed == self._brake.speed:
            return
        self._braker.cancel()
        self._brake.set(speed)
        if speed > 0.0:
            self._braker.timer_period_ns = self._brake.period
            self._braker.reset()
        else:
            self._on_brake()

    def switch(self, is_on: bool, *, single: bool = False) -> bool:
        """Continue, for one tick if `single`, or pause; return whether that was possible."""
        self._is_single = single
        if is_on != self._is_on:
            self._is_on = is_on
            if not self._is_finished:
                self.begin()
        return not (is_on and self._is_finished)

    def reset(self) -> None:
        """Go back to the start."""
        self._run.reset()
        self._is_on = self._is_on and not self._is_single  # a step ends in a pause
        self._is_finished = self._is_single = False
        self._newest_answer = -1
        if self.hand is not None:
            self.hand.on_restart()
        self.begin()

    def command(self, stamp: int, torque: Array, info: Mapping[str, Any]) -> None:
        """Apply the torque, shape (m,), N m, that answers a tick [ns]; ignore late commands.

        The middleware's info on a received command shows whether there are two senders.
        """
        run = self._run
        self._note_answer(stamp)
        contested = self._senders.note(info)
        if not self._is_on or self._is_finished or not 0 <= stamp <= run.stamp:
            return
        if contested:
            self._hold(CONFLICT)
            return
        if stamp <= self._answered:
            return
        self._answered = stamp
        c = self._config
        if not self._is_lockstep and run.stamp - stamp > c.guard.age_limit * c.tick:
            self._too_old += 1  # the guard would reject it
            return
        self._answered_at = time.monotonic()
        if run.refused:
            run.refused = ""
            if self._is_lockstep:
                self._let_time_pass(False)
        self._diagnostics.clear("state")
        if self._is_lockstep and stamp < run.stamp:
            return  # the controller is back; its answer to the current tick follows
        waited = self._waits
        run.command(stamp, torque)
        if waited and not self._waits:
            self._let_time_pass(True)
        if stamp == run.stamp:
            self._pace.answered()
        # Add the simulated time since the answered tick to the time since the newest was sent.
        age = self._answered_at - self._sent_at + 1e-9 * (run.stamp - stamp)
        self._diagnostics.latency(age)
        if self._is_lockstep:
            self._is_answered = True
            self._on_brake()

    def _on_brake(self) -> None:
        """Advance if the tick is answered and the speed permits."""
        if self._is_answered and self._brake.permits():
            self._is_answered = False
            self._advance(1)

    def _note_answer(self, stamp: int) -> None:
        """Report immediately that the first tick, or the last before a stop, is answered.

        The orchestrator waits for both. Subscribing to commands would cost it a packet per tick.
        """
        before, now = self._newest_answer, self._run.stamp
        if before < stamp <= now:
            self._newest_answer = stamp
            stands = self._is_finished or not self._is_on
            if before < 0 or (stands and stamp == now):
                self._node.publish_diagnostics()

    def _hold(self, reason: str) -> None:
        """Hold the joints regardless of commands, while time follows the wall clock."""
        if not self._run.refused:
            self._run.refused = reason
            self._is_answered = False
            if self._is_lockstep:
                self._let_time_pass(True)

    def _let_time_pass(self, passes: bool) -> None:
        self._pace.start(awaits_command=passes)
        self._pacer.reset()
        if not passes:
            self._pacer.cancel()

    def _advance(self, ticks: int) -> None:
        """Advance and publish the newest tick."""
        for done in range(ticks):
            if self._run.is_last:
                if done:
                    self._publish()
                self._is_finished = True
                self._let_time_pass(False)
                self._modes.note(self.mode)
                self._announce(f"finished at {1e-9 * self._run.stamp:g} s", OK)
                return
            try:
                self._run.advance()
            except DivergedError as error:  # there is no valid state to continue from
                self._is_on = False
                self._let_time_pass(False)
                self._announce(f"{error} (~/reset, then ~/run)", ERROR)
                return
        if self._is_single:
            self._is_single = self._is_on = False
            self._let_time_pass(False)
        self._publish()
        self._publish_hold()

    def _publish_hold(self) -> None:
        held = self._run.guard.holding
        self._topics.publish_hold(held)
        self._modes.note(self.mode, self._run.reason)
        if self.hand is not None:
            self.hand.hold(held)

    def _publish(self) -> None:
        """Publish the current tick, and compute the answer of a hand in this process."""
        state, stamp = self._run.state, self._run.stamp
        self._topics.publish(stamp, state)
        self._sent_at = time.monotonic()
        self._diagnostics.tick()
        if self.hand is None:
            return
        self._torque = self.hand.answer(stamp, state)
        if not self._is_lockstep:
            self._take_answer()

    def _take_answer(self) -> None:
        if self._torque is not None:
            torque, self._torque = self._torque, None
            self.command(self._run.stamp, torque, {})

    def work(self) -> bool:
        """Run ticks of a hand in this process for a moment; return whether more are ready."""
        end = time.monotonic() + _TURN
        while self._torque is not None and time.monotonic() < end:
            self._take_answer()
        return self._torque is not None

    def _announce(self, text: str, level: bytes) -> None:
        """Publish a state immediately."""
        self._diagnostics.fault("state", text, level)
        self._node.publish_diagnostics()

    def _on_pace(self) -> None:
        if due := self._pace.due():
            self._advance(1 if self._is_single else due)

    def _on_watch(self) -> None:
        """Send a tick again after a short silence, hold the joints after a long one."""
        run, c = self._run, self._config
        if not self._is_on or self._is_finished:
            self._watcher.cancel()  # until the next start
            return
        now = time.monotonic()
        if run.refused == CONFLICT and not self._senders.in_conflict:
            run.refused = _LEFT
        if run.refused or not self._waits or self._torque is not None or self._is_answered:
            return
        silence = f"no usable joint_command for {c.command_timeout:g} s"
        if now - self._answered_at >= c.command_timeout and run.commanded:
            self._hold(f"{silence}, expected one for each tick")
        elif now - self._answered_at >= c.command_timeout:
            self._diagnostics.fault("state", f"{silence}, waiting at the first tick", WARN)
        if not run.refused and now - self._sent_at >= c.resend_after:
            self._topics.repeat()
            self._sent_at = now
            self._resent += 1

    def to_safe_state(self, reason: str) -> None:
        """Hold the joints after an unexpected error, until the next valid command."""
        is_idle = not self._is_on or self._is_finished or self._run.refused
        if is_idle or not self._run.commanded:
            return
        self._hold(reason)
        self._announce(f"{reason}; the joints are held", ERROR)

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report mode, time and silence as diagnostics values."""
        put("mode", self.mode)
        put("finished", self._is_finished)
        put("time_s", 1e-9 * self._run.stamp)
        put("tick_ns", self._run.stamp)
        put("answered_ns", self._newest_answer)
        put("resent_ticks", self._resent)
        guard = self._run.guard
        held = f"{guard.reason}; the joints are held"
        self._diagnostics.judge("hold", bool(guard.reason), held)
        put("held_ticks", guard.held)
        put("command_age_ticks", guard.age)
        for reason, count in guard.holds.items():
            put(f"holds: {reason}", count)
        put("too_old_commands", self._too_old)
        put("conflicting_commands", self._senders.conflicts)
        put("late_commands", self._pace.late)
        put("missed_ticks", self._pace.skipped)
        put("lost_s", 1e-9 * self._pace.lost_ns)
