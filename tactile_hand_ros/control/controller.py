# SPDX-License-Identifier: Apache-2.0
"""The manipulation controller: targets over time, one of the laws, and a safe hold around them."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, all_finite, in_palm
from tactile_hand_ros.control.holds import (
    JointRates,
    bearable_fraction,
    fitted_gains,
    required_bandwidth,
    spring,
    stiffest,
)
from tactile_hand_ros.control.laws import (
    AuxiliaryPose,
    LawConfig,
    LawFactory,
    LawTorque,
    ManipulationLaw,
    Target,
)
from tactile_hand_ros.control.plausibility import InputCheck, Tolerances, implausible_shape
from tactile_hand_ros.control.reach import end_of, room
from tactile_hand_ros.control.regrasp import Regrasp, RegraspConfig
from tactile_hand_ros.control.targets import Grasp, SmoothReference, TargetQueue
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.hand.hand import Fingertips, Hand
from tactile_hand_ros.rotations import rotation_from_quaternion

Array = NDArray[np.float64]

_NOT_FINITE = "the law has no finite torque; holding until its inputs are plausible again"

_LONGEST_GAP = 0.05  # s; of a longer pause no more is integrated or moved in one tick
_SHORTEST_LEVER = 1e-6  # m, far below any hand's: what is solved with it has a solution
_MOVES_UNTIL = 0.8  # of the limit of k_f; the rest is for what still comes when the move has ended
_ROOM = 0.1  # fraction of the way to a rim or the end of a joint at which a move ends
_LONGEST_PERIOD = 0.01  # s between ticks; what is assumed before two were seen


class PostureHoldConfig(Config):
    """What sets the stiffness of the hold, apart from the tick period."""

    latency: int = param(
        3, "ticks by which a torque may act late", unit="ticks", live=True, ge=0, le=100
    )
    resolution: float = param(
        0.0, "error of a measured joint angle, 0 if exact", unit="rad", live=True, ge=0.0, le=0.1
    )


class ControllerConfig(Config):
    """Parameters of the manipulation controller."""

    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    law: LawConfig = LawConfig()
    gravity_compensation: bool = param(False, "carry the links' weight by feed-forward", live=True)
    gravity: tuple[float, float, float] = param(
        (0.0, 0.0, -9.81),
        "acceleration of gravity in the palm frame, with an imu in the world",
        unit="m/s^2",
    )
    imu: bool = param(False, "take how the palm lies from the topic imu, and wait for it")
    midpoint_hold: bool = param(
        False,
        "extrapolate torques by half a period, since each is held for one (needs quiet sensors)",
        live=True,
    )
    reference_time: float = param(
        0.4,
        "time constant with which the hand follows a new desired pose, 0 for immediately",
        unit="s",
        live=True,
        ge=0.0,
        le=60.0,
    )
    hold: PostureHoldConfig = PostureHoldConfig()
    regrasp: RegraspConfig = RegraspConfig()
    touch_tolerance: float = param(
        0.0,
        "largest distance between a contact and the fingertip that the joints put it on, 0 for a "
        "sixth of its radius",
        unit="m",
        live=True,
        ge=0.0,
    )
    force_tolerance: float = param(
        0.3,
        "largest error of the measured forces against the joint torques, as a fraction, 0 for any",
        live=True,
        ge=0.0,
    )
    touch_latency: float = param(
        0.015,
        "largest age of measured forces, with the time between samples; they are compared with "
        "the joint torques since then",
        unit="s",
        live=True,
        ge=0.0,
        le=0.5,
    )
    grasp_force_limit: float = param(
        0.0, "largest k_f that is accepted, 0 for any", unit="N", live=True, ge=0.0
    )
    input_timeout: float = param(
        0.5,
        "silence of touch, f* or k_f, by the stamps of joint states, after which the hand holds",
        unit="s",
        gt=0.0,
        le=60.0,
    )


class Mode(enum.Enum):
    """What the controller is doing: its state."""

    NO_GRASP = "no grasp"
    DRIVE = "drive"
    HOLD = "hold"
    OPEN = "open"
    DISABLED = "disabled"


class Held(NamedTuple):
    """What a hold keeps of the last good tick.

    Attributes:
        internal: Torque of the internal force, shape (m,), N m.
        load: Torque that compensates the load, shape (m,), N m.
        grasp_force: k_f to which the internal force belongs, N; 0 where it is not known.
    """

    internal: Array
    load: Array
    grasp_force: float = 0.0

    def raised(self, grasp_force: float) -> Held:
        """Return it with the internal force of a larger k_f, N; it never falls."""
        if not (self.grasp_force > 0.0 and self.grasp_force < grasp_force < math.inf):
            return self
        factor = grasp_force / self.grasp_force
        return Held(factor * self.internal, self.load, grasp_force)


class Command(NamedTuple):
    """What the controller answers to one tick.

    Attributes:
        torque: Joint torques, shape (m,), N m.
        mode: Drive, hold, open or disabled; hold also without a grasp.
        pose: What the hand estimates of the object; None when it does not know.
        reason: Why it holds, or why a target was refused; empty otherwise.
        do_not_send: Whether to keep it back: an input is missing or implausible, and the guard of
            the joints, which needs none of them, holds better.
    """

    torque: Array
    mode: Mode
    pose: AuxiliaryPose | None
    reason: str = ""
    do_not_send: bool = False


class Controller:
    """Answers each tick with joint torques; sees joints and touch only.

    Without a target the grasp is kept where it was first seen. When a contact, f* or k_f is missing
    or implausible, or the contacts lie on a line, the hand holds its posture and its last good
    grasp force, with a spring as stiff as the period of the ticks allows; see `holds`.

    Attributes:
        enabled: Whether the law acts, instead of mere damping.
        touch_rejected: Whether touch teaches nothing: when joints and touch last came, they did not
            fit each other, or a guard held the joints, which shakes the grasp and which no k_f
            reaches. An open or disabled hand rejects nothing.
        joints_held: Whether a guard holds the joints, so that no torque from here reaches them. The
            integral and the reference wait for the end of that.
        warning: Why this grasp could not be held without inputs; empty where it could.
    """

    def __init__(self, config: ControllerConfig, law: LawFactory | None = None) -> None:
        """Build the controller.

        Args:
            config: Its parameters.
            law: A law in the place of the one that they name.

        Raises:
            HandModelError: If the hand cannot be built.
        """
        self.config = config
        self.hand = Hand.load(config.hand, config.layout, np.array(config.gravity))
        self._law = ManipulationLaw(config.law, self.hand.radii, law)
        self._reference = SmoothReference()
        self._rates = JointRates(self.hand.joints)
        self._regrasp = Regrasp(config.regrasp, self.hand)
        self.enabled = True
        self.joints_held = False
        self._palm: Array | None = None  # its rotation in the world, where an imu shows it
        self._targets = TargetQueue(self.hand)
        self.reset()

    def configure(self, config: ControllerConfig) -> None:
        """Take other gains while running."""
        self.config = config
        self._law.configure(config.law)

    def reset(self) -> None:
        """Forget everything, also that the fingers are open: time or hand are new."""
        self._regrasp.finish()
        self.forget()

    def forget(self) -> None:
        """Forget grasp, targets and integral; open or closing fingers continue with that."""
        self._law.reset()
        self._hold_with(np.ones(self.hand.fingers, dtype=bool))
        self._new_grasp()
        self._reference.reset()
        self._rates.reset()
        self._targets.reset()
        self._mode = Mode.NO_GRASP
        self._held: Held | None = None  # nothing is known to be held
        self._posture = np.zeros(self.hand.joints)  # that a hold keeps
        self._grasp: Grasp | None = None
        self._last_torque: Array | None = None  # of the law, one tick ago
        self._last_stamp: int | None = None
        self._period = _LONGEST_PERIOD  # of the ticks, s
        self._accept_inputs()

    def _hold_with(self, touching: NDArray[np.bool_]) -> None:
        """Let fingers hold from now on, by a mask of shape (k,)."""
        self._touching, self._fingers = touching, self.hand.part(touching)
        self._inputs = InputCheck(self._fingers)
        self._room: Array | None = None  # largest during the present move, see `room`

    def _new_grasp(self) -> None:
        self.warning, self._fitted_to, self._fitted_fingers = "", 0.0, 0
        # Bandwidth that a hold needs per root of k_f, and that it has, rad/s.
        self._required: tuple[float, float] | None = None

    def _accept_inputs(self) -> None:
        """Forget all doubts."""
        self.touch_rejected = False
        self._implausible_since: int | None = None  # first tick of those with an implausible input

    def _enter(self, mode: Mode, theta: Array) -> None:
        """Change the state; a hold keeps the posture in which it begins, shape (m,), rad."""
        if mode is self._mode:
            return
        self._mode, self._last_torque = mode, None
        if mode is not Mode.DRIVE:
            self._reference.reset()
            self._posture = theta.copy()
        if mode in (Mode.OPEN, Mode.DISABLED):
            self._accept_inputs()
            self._held = self._nothing

    @property
    def _nothing(self) -> Held:
        """What an open or disabled hand holds."""
        return Held(np.zeros(self.hand.joints), np.zeros(self.hand.joints))

    def turn_palm(self, orientation: Array) -> None:
        """Let gravity act as the palm lies, a quaternion (x, y, z, w) in the world, shape (4,)."""
        self._palm = rotation_from_quaternion(orientation)
        self.hand.gravity = self._palm.T @ np.array(self.config.gravity)

    @property
    def missing(self) -> str:
        """Which fingers close while the others hold; empty where all touch, or the hand is open."""
        if self._mode is not Mode.DRIVE or self._touching.all():
            return ""
        names = ", ".join(self.hand.part(~self._touching).finger_names)
        return f"no contact at {names}; closing, while the other fingers hold"

    @property
    def target(self) -> Target | None:
        """The desired pose in force; None before the first tick."""
        return self._targets.target

    @property
    def accepted(self) -> Target | None:
        """The desired pose that became the target in the last step; None if none did."""
        return self._targets.accepted

    @property
    def dropped(self) -> int:
        """Desired poses that were forgotten because too many waited."""
        return self._targets.dropped

    def command(self, target: Target, stamp: int = 0) -> None:
        """Take a desired pose; where `MAX_WAITING` wait already, the earliest is dropped.

        A pose that cannot be reached is refused here, or, after `MAX_CHECKED` poses in one tick,
        when it is due.

        Args:
            target: Desired pose of the contact centroid's virtual frame, palm frame.
            stamp: Tick in ns from which it holds; zero or a past one means now.

        Raises:
            PoseError: If the present grasp cannot be carried there.
        """
        self._targets.command(target, stamp, self._last_stamp, self._grasp)

    def schedule(self, target: Target, stamp: int, *, judged: bool) -> None:
        """Queue a desired pose as `command` does, without judging now whether it is in reach.

        Args:
            target: The pose.
            stamp: Tick in ns from which it holds; zero or a past one means now.
            judged: Whether it is known to be in reach; otherwise it is judged when it is due.
        """
        self._targets.schedule(target, stamp, self._last_stamp, judged=judged)

    def forget_after(self, stamp: int) -> list[int]:
        """Forget the desired poses for ticks after one, in ns; return the stamps they had."""
        return self._targets.forget_after(stamp)

    def release(self) -> None:
        """Release the object: the fingers open along the normals of the last grasp.

        Raises:
            GraspError: If there has been no grasp yet.
        """
        if self._regrasp.active:
            self._regrasp.open()
            return
        if self._grasp is None:
            raise GraspError("there is no grasp to release; let all fingers touch first")
        self._regrasp.leave(self._grasp.theta, self._grasp.contacts)

    @property
    def is_open(self) -> bool:
        """Whether the fingers are open, opening or closing."""
        return self._regrasp.active

    def grasp(self) -> None:
        """Close the fingers until all of them touch, and take what they hold as a new grasp."""
        if self._regrasp.active:
            self._regrasp.close()

    def step(
        self,
        stamp: int,
        theta: Array,
        rates: Array,
        contacts: Contacts,
        optimal_forces: Array,
        grasp_force: float,
        forces: Array | None = None,
        applied: Array | None = None,
    ) -> Command:
        """Answer a tick for which everything has arrived.

        Args:
            stamp: The tick, ns.
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            contacts: Contacts by touch; NaN where there is none.
            optimal_forces: f* in contact frames, shape (k, 3); NaN when (13) has no answer.
            grasp_force: k_f, N.
            forces: Measured forces in contact frames, shape (k, 3), N; for the load observer.
            applied: Torque of the joints since the last tick, shape (m,), N m; None if unknown.
        """
        dt = self._elapsed(stamp)
        rates = self._rates.step(stamp, theta, rates, self.config.hold.resolution)
        self._targets.start_tick()
        if not self.enabled:
            return self._disabled(theta, rates)
        if self._regrasp.active:
            if not self._regrasped(contacts):
                return self._open(theta, rates, contacts, dt)
            dt = 0.0  # a new grasp has no past
        problem = self._missing(contacts, optimal_forces, grasp_force)
        if problem:
            self._inputs.start_grasp()
            return self._holding(theta, rates, problem, grasp_force, applied)
        self._follow_touch(contacts.touching)
        whole, contacts = contacts, contacts.part(self._touching)
        optimal_forces = optimal_forces[self._touching]
        forces = None if forces is None else forces[self._touching]
        tips, problem = self._checked(stamp, theta, rates, contacts, forces, applied)
        problem = problem or self._implausible(optimal_forces, grasp_force)
        if problem:
            return self._reject_inputs(stamp, theta, rates, problem, applied)
        self._implausible_since = None
        try:
            pose = self._law.auxiliary_pose(tips, contacts)
            self._grasp = Grasp(theta, whole, pose)
            refused = self._targets.take_due(stamp, self._grasp)
            wanted = self._way_to_target(pose, dt)
            refused = self._stopped(theta, contacts, pose, grasp_force) or refused
            self._fit(theta, contacts, optimal_forces)
            parts = self._law.step(
                tips, rates, contacts, optimal_forces, grasp_force, wanted, pose, dt, forces
            )
        except GraspError as error:
            return self._holding(theta, rates, str(error), applied=applied)
        total = parts.total
        # The square overflows only for torques that no joint could have: one check for all of them.
        if not math.isfinite(total.dot(total)):
            self._law.reset()
            return self._holding(theta, rates, _NOT_FINITE, applied=applied)
        self._enter(Mode.DRIVE, theta)
        self._held = Held(parts.internal, parts.load_compensation, grasp_force)
        if dt > 0.0:  # the rate of the ticks is known
            self._judge_hold(theta, contacts, optimal_forces, grasp_force)
        torque = self._ahead(self._bearable(parts, self._weight(theta)), dt)
        if not self._touching.all():
            torque = self._closing(torque, theta, rates, contacts.centroid)
        return Command(torque, Mode.DRIVE, pose, refused)

    def _follow_touch(self, touching: NDArray[np.bool_]) -> None:
        """Hold with the fingers that touch, by a mask of shape (k,), without a jump of the law."""
        if (touching != self._touching).any():
            self._hold_with(touching)
            self._law.change_fingers()

    def _closing(self, torque: Array, theta: Array, rates: Array, middle: Array) -> Array:
        """Return torques with which the fingers that do not touch close, shape (m,), N m.

        Their tips move towards the middle of the contacts at a given speed. Only the damping to
        that speed presses on what stops them where they feel no touch.

        Args:
            torque: That of the others, shape (m,), N m.
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            middle: Centroid of the contacts, shape (3,), m.
        """
        hand = self.hand.part(~self._touching)
        tips, inertia, bias = hand.dynamics(theta, rates)
        away = middle - tips.positions
        distances = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), hand.radii[:, None])
        jacobian, speed = tips.linear.reshape(-1, hand.joints), self.config.regrasp.speed
        # Damped least squares: near a straight finger, rates stay below half of their limits.
        lever = max(speed / hand.velocity_limits.min(), _SHORTEST_LEVER)
        normal = jacobian @ jacobian.T + lever**2 * np.eye(len(jacobian))
        wanted = jacobian.T @ np.linalg.solve(normal, (speed * away / distances).ravel())
        w, still = self._stiffest(inertia), np.zeros(hand.joints)
        closing = bias + spring(inertia, w, still, wanted - rates)
        limits = hand.effort_limits
        return np.where(jacobian.any(axis=0), np.clip(closing, -limits, limits), torque)

    def _checked(
        self,
        stamp: int,
        theta: Array,
        rates: Array,
        contacts: Contacts,
        forces: Array | None,
        applied: Array | None,
    ) -> tuple[Fingertips, str]:
        """Return the fingertips, and why joints and touch do not fit; see `step`."""
        pressing, c = None, self.config
        if self._compares_forces and forces is not None and applied is not None:
            pressing = forces, applied
        limits = Tolerances(
            c.touch_tolerance, c.force_tolerance, c.touch_latency, self._rates.error
        )
        seen = contacts, limits, pressing, self._palm
        tips, problem = self._inputs.step(stamp, theta, rates, *seen)
        self.touch_rejected = bool(problem) or self.joints_held
        return tips, problem

    def _way_to_target(self, pose: AuxiliaryPose, dt: float) -> Target:
        """Return the pose on the way to the target that the law aims at in this tick."""
        assert self.target is not None
        self._law.acts = not self.joints_held
        passed = 0.0 if self.joints_held else dt  # a reference that waits continues where it was
        return self._reference.step(self.target, pose, self.config.reference_time, passed)

    def _stopped(
        self, theta: Array, contacts: Contacts, pose: AuxiliaryPose, grasp_force: float
    ) -> str:
        """Return why the grasp stays where it is from now on; empty if it moves on."""
        if not self._reference.is_moving:
            self._room = None
            return ""
        problem = self._way_ends(theta, contacts, grasp_force)
        if not problem:
            return ""
        self._reference.reset()
        self._targets.stay(pose)
        return f"the move ends here: {problem}; go back, or ask for a smaller turn"

    def _way_ends(self, theta: Array, contacts: Contacts, grasp_force: float) -> str:
        """Return why a move should not go on; empty if it may.

        What holds the object where a move begins may not hold it where it ends: a grasp force that
        grows is the sign of it. From near a rim or an end it may go back.
        """
        limit = self.config.grasp_force_limit
        if 0.0 < _MOVES_UNTIL * limit < grasp_force:
            return (
                f"k_f = {grasp_force:.3g} N is near its limit of {limit:g} N, and the way ahead may"
                " need more"
            )
        left = room(self._fingers, theta, contacts)
        self._room = left if self._room is None else np.maximum(self._room, left)
        nearer = (left < self._room - 0.5 * _ROOM) & (self._room > 0.0)
        ends = np.flatnonzero((left < _ROOM) & nearer)
        return f"it brings {end_of(self._fingers, int(ends[0]))}" if len(ends) else ""

    def hold(
        self,
        theta: Array,
        rates: Array,
        reason: str,
        grasp_force: float = 0.0,
        applied: Array | None = None,
        stamp: int | None = None,
    ) -> Command:
        """Answer a tick that misses an input: keep posture and last good grasp force.

        Where a guard holds the joints, without delay and stiffer, it is not relieved by that: the
        answer is not to be sent. The arguments are those of `_holding`, and the tick in ns, from
        which rates follow; without it they are taken as measured.
        """
        if stamp is not None:
            rates = self._rates.step(stamp, theta, rates, self.config.hold.resolution)
        held = self._holding(theta, rates, reason, grasp_force, applied)
        return held._replace(do_not_send=self.joints_held)

    def _holding(
        self,
        theta: Array,
        rates: Array,
        reason: str,
        grasp_force: float = 0.0,
        applied: Array | None = None,
    ) -> Command:
        """Keep posture and last good grasp force.

        A controller that has not grasped yet keeps what acts on the joints: another may have died
        with the object in the hand, and a guard may hold it.

        Args:
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            reason: Why the law cannot answer.
            grasp_force: k_f where it is known, N. The held force rises with it and never falls.
            applied: Torque of the joints since the last tick, shape (m,), N m; None if unknown.
        """
        self._targets.start_tick()
        if not self.enabled:
            return self._disabled(theta, rates)
        self._enter(Mode.HOLD, theta)
        held = self._kept(theta, applied, grasp_force)
        rest = _sum(held.load + self._spring(theta, rates), self._weight(theta))
        fraction = bearable_fraction(held.internal, rest, self.hand.effort_limits)
        return Command(fraction * held.internal + rest, Mode.HOLD, None, reason)

    def _kept(self, theta: Array, applied: Array | None, grasp_force: float) -> Held:
        """Return what the hold keeps, for a k_f in N and torques applied since the last tick."""
        if self._held is None:
            kept = self._nothing
            if applied is None or not applied.any() or not all_finite(applied):
                return kept  # still nothing that is known to act
            weight = self._weight(theta)
            self._held = kept._replace(internal=applied if weight is None else applied - weight)
        self._held = self._held.raised(grasp_force)
        return self._held

    def _spring(self, theta: Array, rates: Array) -> Array:
        """Return the torque that brings the joints back to the posture to hold, (m,), N m."""
        inertia = self.hand.dynamics(theta, rates)[1]
        return spring(inertia, self._stiffest(inertia), self._posture - theta, -rates)

    def _stiffest(self, inertia: Array) -> float:
        """Return the bandwidth of the hold, rad/s."""
        c = self.config.hold
        late = (0.5 + c.latency) * self._period
        return stiffest(self.hand, inertia, self._period, late, c.resolution)

    def _fit(self, theta: Array, contacts: Contacts, optimal_forces: Array) -> None:
        """Fit the gains that are not given to the hand, for its ticks and most of its fingers.

        That takes milliseconds, so a finger that comes and goes changes nothing.
        """
        fingers, c = self._fingers.fingers, self.config
        known = self._fitted_to == self._period and fingers <= self._fitted_fingers
        if self._law.fits or known:
            return
        self._fitted_to, self._fitted_fingers = self._period, fingers
        forces = contacts.centroid - contacts.positions  # of law (10), a guess for one's own
        if c.law.name == "optimal":
            forces = in_palm(contacts.rotations, optimal_forces, 1.0)
        ages = c.touch_latency, c.law.observer.time
        how = forces, self._period, *ages, c.hold.resolution
        self._law.fit(fitted_gains(self._fingers, theta, contacts, *how))

    def _judge_hold(
        self, theta: Array, contacts: Contacts, optimal_forces: Array, grasp_force: float
    ) -> None:
        """Warn once in a grasp if a hold could not keep it at this rate of the ticks."""
        if self.config.law.name != "optimal" or self.warning:
            return
        if self._required is None:
            forces = in_palm(contacts.rotations, optimal_forces, 1.0)
            inertia = self.hand.dynamics(theta, np.zeros(self.hand.joints))[1]
            needed = required_bandwidth(self._fingers, theta, contacts, forces)
            self._required = needed, self._stiffest(inertia)
        required, has = math.sqrt(grasp_force) * self._required[0], self._required[1]
        if required > has:
            rate = 1.0 / self._period
            self.warning = (
                f"without inputs this grasp would buckle: at {rate:.0f} Hz the hold has a bandwidth"
                f" of {has:.0f} rad/s, k_f = {grasp_force:.3g} N needs {required:.0f} rad/s, about"
                f" {rate * required / has:.0f} Hz"
            )

    def _implausible(self, optimal_forces: Array, grasp_force: float) -> str:
        """Return why f* or k_f is implausible; empty if they are not."""
        c = self.config
        if 0.0 < c.grasp_force_limit < grasp_force:
            limit = f"grasp_force_limit = {c.grasp_force_limit:g} N"
            return f"k_f = {grasp_force:.3g} N is above {limit}; holding until it is not"
        return implausible_shape(optimal_forces) if c.law.name == "optimal" else ""

    @property
    def _compares_forces(self) -> bool:
        """Whether measured forces decide what the hand does, and are compared with torques."""
        c = self.config
        return c.law.observer.time > 0.0 and c.force_tolerance > 0.0

    def _reject_inputs(
        self, stamp: int, theta: Array, rates: Array, reason: str, applied: Array | None
    ) -> Command:
        """Answer a tick with an input that is implausible, as if it were missing."""
        if self._implausible_since is None:
            self._implausible_since = stamp
        is_new = 1e-9 * (stamp - self._implausible_since) < self.config.input_timeout
        held = self.hold(theta, rates, reason, applied=applied)
        return held._replace(do_not_send=is_new or held.do_not_send)

    def _disabled(self, theta: Array, rates: Array) -> Command:
        self._enter(Mode.DISABLED, theta)
        self._regrasp.follow(theta)
        damping = self.config.law.damping
        if damping > 0.0:
            torque = -damping * rates
        else:  # that of a hold
            self._posture = theta
            torque = self._spring(theta, rates)
        torque = _sum(torque, self._weight(theta))
        return Command(torque, Mode.DISABLED, None, "disabled by the user")

    def _regrasped(self, contacts: Contacts) -> bool:
        """Return whether closing fingers have touched; then a new grasp begins.

        Where enough touch, the others search as far as they may before it begins without them.
        """
        closing = self._regrasp.closing
        if not closing or not self._enough(contacts) or self._regrasp.searches(contacts):
            return False
        self._regrasp.finish()
        self._law.reset()
        self._targets.start_grasp()
        self._hold_with(contacts.touching)
        self._new_grasp()
        return True

    def _enough(self, contacts: Contacts) -> bool:
        """Return whether so many fingers touch that the law can act."""
        if self.config.law.name == "optimal":
            return contacts.enough_touching
        return contacts.all_touching

    def _open(self, theta: Array, rates: Array, contacts: Contacts, dt: float) -> Command:
        self._enter(Mode.OPEN, theta)
        self._posture = self._regrasp.posture(contacts, dt)
        torque = _sum(self._spring(theta, rates), self._weight(theta))
        reason = self._regrasp.missed or "released by the user"
        return Command(torque, Mode.OPEN, None, reason)

    def _elapsed(self, stamp: int) -> float:
        """Return the time since the last tick in s; 0 after an interruption.

        Nothing is integrated over it, and fingers that open or close continue from where they are.
        """
        before, self._last_stamp = self._last_stamp, stamp
        if before is None or stamp <= before:
            return 0.0
        passed = 1e-9 * (stamp - before)
        self._period = min(self._period, passed)
        continues = self._mode is (Mode.OPEN if self._regrasp.active else Mode.DRIVE)
        return min(passed, _LONGEST_GAP) if continues else 0.0

    def _missing(self, contacts: Contacts, forces: Array, grasp_force: float) -> str:
        if not self._enough(contacts):
            missing = ", ".join(self.hand.part(~contacts.touching).finger_names)
            return f"no contact at {missing}; holding until they touch again"
        if self.config.law.name == "optimal" and not all_finite(forces[contacts.touching]):
            return "no optimal force f*; holding until the optimizer has an answer"
        if not math.isfinite(grasp_force) or grasp_force < 0.0:
            return f"grasp force k_f = {grasp_force} N is unusable; holding the last grasp force"
        return ""

    def _ahead(self, torque: Array, dt: float) -> Array:
        """Extrapolate by half a period: a torque that is held for T is T/2 old on average.

        Args:
            torque: That of this tick, shape (m,), N m.
            dt: Time since the last one, s.
        """
        last, self._last_torque = self._last_torque, torque
        if not self.config.midpoint_hold or last is None or dt <= 0.0:
            return torque
        return torque + 0.5 * self._period / dt * (torque - last)

    def _bearable(self, parts: LawTorque, weight: Array | None) -> Array:
        """Return what the joints can bear of a law's torques and the links' weight, (m,), N m.

        First comes the internal force with the load, whose shape is kept, then the drive; damping
        takes what is left, joint by joint.
        """
        limits, carried = self.hand.effort_limits, _sum(parts.load_compensation, weight)
        fraction = bearable_fraction(parts.internal, carried, limits)
        internal = parts.internal if fraction == 1.0 else fraction * parts.internal
        torque = internal + carried
        fraction = bearable_fraction(parts.drive, torque, limits)
        drive = parts.drive if fraction == 1.0 else fraction * parts.drive
        torque = torque + drive + parts.damping
        return np.asarray(np.minimum(np.maximum(torque, -limits), limits))

    def _weight(self, theta: Array) -> Array | None:
        """Return the torques that carry the links, shape (m,), N m; None where not wanted."""
        return self.hand.gravity_torque(theta) if self.config.gravity_compensation else None


def _sum(torque: Array, weight: Array | None) -> Array:
    return torque if weight is None else torque + weight
