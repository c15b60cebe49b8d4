# SPDX-License-Identifier: Apache-2.0
"""The guard in front of the joints: it checks each command, and holds the joints without one.

It runs in the plant, or in the driver of a real hand. It uses joint states, commands and the model
of the hand. Time comes from the stamps.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.holds import GraspTorque, GuardHold, GuardHoldConfig
from tactile_hand_ros.control.sensing import JointRates
from tactile_hand_ros.control.stability import buckling_rate
from tactile_hand_ros.hand.hand import Dynamics, Hand, tip_forces

NO_COMMAND = "no command yet"
LATE = "the command is too old"
AHEAD = "the command is ahead of the newest tick"
WRONG_SHAPE = "the command has the wrong number of torques"
NOT_FINITE = "the command is not finite"
TOO_FAST = "a joint is too fast"
BLIND = "the joint states are not finite"
STUCK = "the command does not change although the joints move"
PULLS = "the command pulls the fingers off the object"
UNSTEADY = "commands have failed repeatedly; waiting until they are steady"

_STUCK_MOTION = 0.002  # rad of motion that may leave a torque unchanged, 0.02 radii at a tip
_STUCK_STEPS = 4.0  # errors of an angle that may do so, too
_PULL = 0.2  # fraction of the internal force that a command may pull the fingers apart with
_LATEST = 1.2  # p times the delay: 0.85 of the largest that any feedback bears, see `_buckles`
_SAME_POSTURE = 0.1  # rad that change the levers of a grasp little
_CALM_TIME = 0.5  # s without a hold, after which the next hold ends with the first good command
_CALM = 0.8  # fraction of the speed limit below which a joint counts as slow again


class GuardConfig(Config):
    """Limits of the commands that reach the joints, and the hold without them."""

    age_limit: int = param(
        3, "ticks by which a command may be older than the newest tick", unit="ticks", ge=0, le=1000
    )
    torque_rate: float = param(
        0.0, "fastest change of a torque, 0 for no limit", unit="N m/s", ge=0.0
    )
    speed_limit: float = param(
        0.0, "joint speed from which the joints are held, 0 for the URDF's", unit="rad/s", ge=0.0
    )
    blend_time: float = param(0.02, "duration of a takeover", unit="s", gt=0.0, le=10.0)
    patience: float = param(
        0.05,
        "time of good commands that stops a series of holds; averages their delay",
        unit="s",
        ge=0.0,
        le=10.0,
    )
    hold: GuardHoldConfig = GuardHoldConfig()


class TorqueCommand(NamedTuple):
    """Torques for the joints, shape (m,), N m, and the stamp of the tick they answer, ns."""

    stamp: int
    torque: Array


class _Sample(NamedTuple):
    """A past tick: stamp, ns, joint angles, rad, rates, rad/s, and the torque from then, N m."""

    stamp: int
    theta: Array
    rates: Array
    torque: Array


class State(enum.Enum):
    """Source of the torque: commands, the hold, or commands that take over from it."""

    ACT = "act"
    HOLD = "hold"
    BLEND = "blend"


class CommandGuard:
    """Chooses the torque of the joints at each tick: the command or a hold.

    Good commands pass unchanged, inside the limits of the joints. A hold starts when a command is
    too old, not finite, of the wrong shape, stuck or refused, when a joint is too fast, or when a
    joint state is not finite; see `GuardHold`. Good commands take over within `blend_time`. If
    holds follow each other, as on an overloaded computer, they must first be good for `patience`.

    Attributes:
        state: Whether commands act.
        reason: Why the joints are held; empty while commands act.
        held: Number of held ticks since the reset.
        holds: Number of holds since the reset, by reason.
        age: Age of the last checked command, in full ticks; -1 before the first.
    """

    def __init__(self, config: GuardConfig, hand: Hand, tick: int, step: int = 0) -> None:
        """Build the guard of a hand with the gravity that acts on it, for ticks in ns.

        `step` is the time between two calls of `step`, ns; by default a tick. A faster drive holds
        the joints stiffer.
        """
        self._config, self._hand, self._tick, self._step = config, hand, tick, step or tick
        self._hold = GuardHold(config.hold, hand, 1e-9 * self._step)
        self._rates = JointRates(hand.joints)
        self._fastest = np.where(config.speed_limit > 0.0, config.speed_limit, hand.velocity_limits)
        # Of a step in the mean delay, whose time constant is `patience`.
        self._weight = -math.expm1(-1e-9 * self._step / max(config.patience, 1e-9))
        self._change = 1e-9 * self._step * config.torque_rate or np.inf
        self._past: deque[_Sample] = deque(maxlen=config.age_limit + 2)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as at the start."""
        self._past.clear()
        self._rates.reset()
        self._last: Array | None = None  # commanded torque inside the limits
        self._newest: TorqueCommand | None = None
        self._posture = np.zeros(self._hand.joints)  # when the torque last changed
        self._grasp: tuple[Array, float] | None = None  # posture, and its p at 1 N
        self._judged = -1, False  # stamp of a command, ns, and whether it came too late
        self.state = State.ACT
        self._bad: int | None = None  # last tick without a good command, ns
        self._patience = 0  # ns for which commands must be good to take over
        self.reason = ""
        self.held, self._held_at = 0, -1  # ticks; the last one
        self.holds: Counter[str] = Counter()
        self.age, self._delay = -1, 0.0  # ns, mean age of commands within the limit

    @property
    def holding(self) -> bool:
        """Whether the joints are held, or commands are still taking over."""
        return self.state is not State.ACT

    def step(
        self,
        stamp: int,
        theta: Array,
        rates: Array,
        command: TorqueCommand | None,
        refused: str = "",
    ) -> Array:
        """Return the torque to apply from the tick `stamp`, ns, on, shape (m,), N m.

        Joint angles, rad, and rates, rad/s, are those of the tick. The command is the newest one,
        None before the first. `refused` is why commands are refused now, such as a second sender.
        """
        theta, rates = np.array(theta), np.array(rates)  # a driver may use its buffers again
        is_blind = not (np.isfinite(theta).all() and np.isfinite(rates).all())
        if is_blind and not self._past:
            self._note(stamp, BLIND)
            return np.zeros(self._hand.joints)
        if is_blind:  # assume that the joints continue their motion, or follow the hold
            last, before = self._past[-1], self._past[max(-2, -len(self._past))]
            on = 2.0 * last.theta - before.theta, 2.0 * last.rates - before.rates
            theta, rates = self._hold.reference if self.state is State.HOLD else on
        else:
            rates = self._rates.step(stamp, theta, rates, self._config.hold.resolution)
        reason = BLIND if is_blind else refused or self._judge(stamp, theta, rates, command)
        state, reason = self.state, self._moved_on(stamp, reason)
        if self.state is State.ACT:
            assert command is not None
            torque = self._limited(command.torque)
        else:
            torque = self._guarded(state, stamp, theta, rates, command, reason)
        self._past.append(_Sample(stamp, theta, rates, torque))
        return torque

    def _moved_on(self, stamp: int, reason: str) -> str:
        """Change the state if it is time, and return why the joints are held; empty if not.

        The argument `reason` is why the command at this tick, in ns, is bad.
        """
        before, since_bad = self.state, np.inf if self._bad is None else stamp - self._bad
        if reason:
            if before is not State.HOLD:
                is_calm = since_bad > 1e9 * _CALM_TIME
                self._patience = 0 if is_calm else round(1e9 * self._config.patience)
            self._bad, self.state = stamp, State.HOLD
        elif before is State.HOLD and since_bad > self._patience:
            self.state = State.BLEND
            self._blend_start = stamp - self._step
        elif before is State.HOLD:
            reason = UNSTEADY
        if self.state is State.BLEND and self._blended(stamp) >= 1.0:
            self.state = State.ACT
        if not reason:
            self.reason = ""
        return reason

    def _blended(self, stamp: int) -> float:
        """Return the fraction of the command in the torque at a tick in ns, up to 1."""
        return min(1.0, 1e-9 * (stamp - self._blend_start) / self._config.blend_time)

    def _is_stuck(self, theta: Array, command: TorqueCommand) -> bool:
        """Return whether new commands repeat an old torque although the joints have moved.

        A law gives another torque at another posture. The same command again, as when the next one
        is late, is checked by its age alone.
        """
        before, self._newest = self._newest, command._replace(torque=command.torque.copy())
        if before is None or not np.array_equal(before.torque, command.torque):
            self._posture = theta.copy()
            return False
        if before.stamp == command.stamp and self.reason != STUCK:
            return False
        still = max(_STUCK_MOTION, _STUCK_STEPS * self._config.hold.resolution)
        return bool(np.abs(theta - self._posture).max() > still)

    def _judge(self, stamp: int, theta: Array, rates: Array, command: TorqueCommand | None) -> str:
        """Return why a command is bad; empty if it is good."""
        if command is None:
            return NO_COMMAND
        self.age = int((stamp - command.stamp) / self._tick)  # in ticks that have passed
        if self.age < 0:
            return AHEAD
        if self.age > self._config.age_limit:
            return LATE
        self._delay += self._weight * (stamp - command.stamp - self._delay)
        if command.torque.shape != rates.shape:
            return WRONG_SHAPE
        if not np.isfinite(command.torque).all():
            return NOT_FINITE
        if self._buckles(theta, rates, command):
            return LATE
        if self._is_stuck(theta, command):
            return STUCK
        if self._pulls_apart(stamp, theta, rates, command.torque):
            return PULLS
        limit = _CALM * self._fastest if self.reason == TOO_FAST else self._fastest
        return TOO_FAST if (np.abs(rates) > limit).any() else ""

    def _buckles(self, theta: Array, rates: Array, command: TorqueCommand) -> bool:
        """Return whether torques are on average too late for a law to keep this grasp.

        No feedback of angles and rates that is late by more than sqrt(2) / p stabilizes a motion
        that grows with e^(p t) (Stepan, 2009). On time, torques are late by half a tick. Each
        command is judged once.
        """
        if command.stamp != self._judged[0]:
            late = self._delay > self._tick
            bound = 1e-9 * self._delay * self._buckling(theta, rates, command.torque) if late else 0
            self._judged = command.stamp, bound > _LATEST
        return self._judged[1]

    def _buckling(self, theta: Array, rates: Array, torque: Array) -> float:
        """Return the p with which the grasp of a command would buckle, 1/s."""
        tips, _, bias = self._hand.dynamics(theta, rates)
        internal = tip_forces(tips, torque - bias)
        internal -= internal.mean(axis=0)
        sizes = np.linalg.norm(internal, axis=1, keepdims=True)
        force = float(sizes.sum())
        if not self._hand.minimum_force < force < math.inf:
            return 0.0
        if self._grasp is None or np.abs(theta - self._grasp[0]).max() > _SAME_POSTURE:
            # The contacts, where the forces leave the tips: p is accurate to 12 % with them.
            arms = self._hand.radii[:, None] * internal / np.maximum(sizes, 1e-9 * force)
            contacts = Contacts(tips.positions + arms, np.tile(np.eye(3), (len(arms), 1, 1)))
            self._grasp = theta, buckling_rate(self._hand, theta, contacts, internal / force)
        return math.sqrt(force) * self._grasp[1]

    def _pulls_apart(self, stamp: int, theta: Array, rates: Array, torque: Array) -> bool:
        """Return whether a command reverses the internal force.

        To release the object, fingers stop pressing and open. Only a wrong command pulls them off
        with a force close to the one they press with. Such a command is a large jump of the torque,
        so the tips are computed only after a jump.
        """
        if not self._past:
            return False
        jump = np.abs(torque - self._past[-1].torque).max()
        if jump < self._hand.minimum_force * self._hand.spans.min():
            return False
        terms = self._hand.dynamics(theta, rates)
        tips, pressed = terms.tips, self._pressed(stamp, rates, terms)
        presses = GraspTorque.of(tips, pressed).internal_forces(tips)
        if np.linalg.norm(presses, axis=1).sum() < self._hand.minimum_force:
            return False
        wanted = GraspTorque.of(tips, torque - terms.bias).internal_forces(tips)
        return bool(np.vdot(wanted, presses) < -_PULL * np.vdot(presses, presses))

    def _limited(self, torque: Array) -> Array:
        """Return a commanded torque inside the limits of the joints and of its change."""
        limit = self._hand.effort_limits
        torque = np.minimum(np.maximum(torque, -limit), limit)
        if self._last is not None and self._change < np.inf:
            change = np.minimum(np.maximum(torque - self._last, -self._change), self._change)
            torque = self._last + change
        self._last = torque
        return torque

    def _guarded(
        self,
        before: State,
        stamp: int,
        theta: Array,
        rates: Array,
        command: TorqueCommand | None,
        reason: str,
    ) -> Array:
        """Hold the joints, or blend a good command in; `before` is the last state."""
        terms = self._hand.dynamics(theta, rates)
        if reason:
            if before is State.ACT:
                self._hold.engage(theta, rates, self._pressed(stamp, rates, terms))
            elif before is State.BLEND:
                self._hold.brake(theta, rates)
            self._note(stamp, reason)
        seen = None if reason == BLIND else (theta, rates)
        torque = self._hold.step(seen, terms, follows=bool(reason))
        if not reason:
            assert command is not None
            torque = torque + self._blended(stamp) * (self._limited(command.torque) - torque)
        limit = self._hand.effort_limits
        return np.asarray(np.minimum(np.maximum(torque, -limit), limit))

    def _note(self, stamp: int, reason: str) -> None:
        before, self._held_at = self._held_at, stamp // self._tick
        self.held += self._held_at != before
        if UNSTEADY not in (reason, self.reason):  # otherwise the last hold continues
            self.holds[reason] += reason != self.reason
        self.reason = reason
        self._last = None

    def _pressed(self, stamp: int, rates: Array, terms: Dynamics) -> Array:
        """Return the mean torque of the contacts, tau - M theta'' - bias, shape (m,), N m."""
        if not self._past or stamp == self._past[0].stamp:
            return np.zeros(self._hand.joints)
        first, acceleration = self._past[0], np.zeros(self._hand.joints)
        if stamp > first.stamp:  # otherwise time was set back
            acceleration = (rates - first.rates) / (1e-9 * (stamp - first.stamp))
        torque = np.mean([sample.torque for sample in self._past], axis=0)
        return np.asarray(torque - terms.inertia @ acceleration - terms.bias)
