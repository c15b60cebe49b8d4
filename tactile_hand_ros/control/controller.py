# SPDX-License-Identifier: Apache-2.0
"""The manipulation controller: desired poses, a control law and a safe hold."""

from __future__ import annotations

import enum
import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, all_finite, in_palm
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.holds import (
    GraspTorque,
    Held,
    PostureHold,
    PostureHoldConfig,
    spring,
)
from tactile_hand_ros.control.laws import (
    AuxiliaryPose,
    LawConfig,
    LawInput,
    LawTorque,
    ManipulationLaw,
    NormalForceControl,
    Target,
)
from tactile_hand_ros.control.plausibility import (
    InputCheck,
    Tolerances,
    implausible_shape,
)
from tactile_hand_ros.control.reach import end_of, room
from tactile_hand_ros.control.regrasp import Regrasp, RegraspConfig
from tactile_hand_ros.control.sensing import JointRates, LateTouch, TorqueDelay, UnfeltTouch
from tactile_hand_ros.control.stability import (
    buckling_rate,
    fitted_gains,
    kept_contacts,
    motions_of_object,
    required_bandwidth,
)
from tactile_hand_ros.control.targets import Grasp, SmoothReference, TargetQueue
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.hand.hand import Fingertips, Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import rotation_from_quaternion

_NOT_FINITE = "the law gives no finite torque; holding until its inputs are plausible"

_LONGEST_GAP = 0.05  # s; after a longer pause a tick integrates and moves no more than this
_SHORTEST_LEVER = 1e-6  # m, far below any hand's; keeps the linear system regular
_MOVES_UNTIL = 0.8  # fraction of the limit of k_f at which a move stops, before the load grows
_INTERVALS = 32  # between ticks; a quarter is shorter than the period, as stamps jitter, and many
# are longer on a busy computer, which skips ticks
_OPPOSES = 0.4  # of the normal forces; a finger that opposes all others has half
_NEW_PERIOD = 0.2  # relative change of the period for which gains are fitted again

NO_POSES = (
    "the law 'grip' keeps its posture and moves no object, since normal forces do not show a load; "
    "use the law optimal with a skin that measures three axes"
)
"""Why the law `grip` rejects desired poses."""

FEWEST_MOTIONS = 3
"""Directions in which joints must move the object so that its pose can be controlled."""

LEAST_ROOM = 0.1
"""Fraction of the way to a rim or the end of a joint that a move must leave."""


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
    imu: bool = param(False, "take the orientation of the palm from the topic imu, and wait for it")
    midpoint_hold: bool = param(
        False,
        "extrapolate torques by half a period, not joints and contacts (needs quiet sensors)",
        live=True,
    )
    reference_time: float = param(
        0.4, "time constant to a new desired pose, 0 for none", unit="s", live=True, ge=0.0, le=60.0
    )
    hold: PostureHoldConfig = PostureHoldConfig()
    regrasp: RegraspConfig = RegraspConfig()
    touch_tolerance: float = param(
        0.0,
        "largest distance between a contact and its fingertip by the joint angles, 0 for a sixth "
        "of the radius of the tip",
        unit="m",
        live=True,
        ge=0.0,
    )
    force_tolerance: float = param(
        0.3,
        "largest error of the measured forces against the joint torques, as a fraction, 0 to skip",
        live=True,
        ge=0.0,
    )
    touch_latency: float = param(
        0.015,
        "largest age of contacts and forces of the skin, with the time between samples",
        unit="s",
        live=True,
        ge=0.0,
        le=0.5,
    )
    grasp_force_limit: float = param(
        0.0, "largest k_f, 0 for no limit", unit="N", live=True, ge=0.0
    )
    input_timeout: float = param(
        0.5,
        "time without valid touch, f* or k_f, by the stamps of joint states, after which the hand "
        "holds",
        unit="s",
        gt=0.0,
        le=60.0,
    )


class Mode(enum.Enum):
    """State of the controller."""

    NO_GRASP = "no grasp"
    DRIVE = "drive"
    HOLD = "hold"
    OPEN = "open"
    DISABLED = "disabled"


class Command(NamedTuple):
    """The answer of the controller to one tick.

    Attributes:
        torque: Joint torques, shape (m,), N m.
        mode: Drive, hold, open or disabled; hold without a grasp, too.
        pose: Estimated pose of the object; None if unknown.
        reason: Why it holds, or why a target was rejected; empty otherwise.
        do_not_send: Whether to withhold it: an input is missing or implausible, and the guard at
            the joints, which needs no inputs but joints, holds better.
    """

    torque: Array
    mode: Mode
    pose: AuxiliaryPose | None
    reason: str = ""
    do_not_send: bool = False


class _Tick(NamedTuple):
    """Input of `Controller.step`, or its part from the fingers that hold; time to integrate, s."""

    stamp: int
    theta: Array
    rates: Array
    applied: Array | None
    contacts: Contacts
    optimal_forces: Array
    grasp_force: float
    forces: Array | None
    elapsed: float

    def part(self, fingers: NDArray[np.bool_]) -> _Tick:
        """Return the input from the fingers in a mask of shape (k,)."""
        forces = None if self.forces is None else self.forces[fingers]
        touch = self.contacts.part(fingers), self.optimal_forces[fingers]
        return self._replace(contacts=touch[0], optimal_forces=touch[1], forces=forces)


class Controller:
    """Answers each tick with joint torques, from joints and touch alone.

    Without a target the grasp stays where it was first seen. The hand holds its posture and its
    last good grasp force when f*, k_f or a contact that the joints cannot replace is missing or
    implausible, or the contacts lie on a line. The spring of the hold is as stiff as the tick
    period allows; see `holds`.

    Attributes:
        targets: Desired poses: the one in force, and those that wait; users command them there.
        enabled: Whether the law acts; otherwise the hand only damps.
        touch_rejected: Fingers whose touch does not fit the joints, so that nothing must be learned
            from it, shape (k,). No finger while the hand is open or disabled.
        joints_held: Whether a guard holds the joints, so that these torques do not reach them. The
            integral and the reference wait meanwhile.
        warning: Why a hold could not keep this grasp; empty if it could.
    """

    def __init__(self, config: ControllerConfig) -> None:
        """Build the controller.

        Raises:
            HandModelError: If the hand cannot be built.
        """
        self.config = config
        self.hand = Hand.load(config.hand, config.layout, np.array(config.gravity))
        self._law = ManipulationLaw(config.law, self.hand.radii)
        self._reference = SmoothReference()
        self._rates = JointRates(self.hand.joints)
        self._regrasp = Regrasp(config.regrasp, self.hand)
        self._hold = PostureHold(config.hold, self.hand)
        self._none = np.zeros(self.hand.joints)
        self.enabled = True
        self.joints_held = False
        self._palm: Array | None = None  # rotation in the world by the imu
        # Bandwidth that a hold needs per newton of k_f, and its bandwidth, rad/s.
        self._required: tuple[float, float] | None = None
        self.targets = TargetQueue(self.hand, NO_POSES if config.law.name == "grip" else "")
        self.reset()

    def configure(self, config: ControllerConfig) -> None:
        """Change the parameters while running; `hand` and `layout` stay."""
        if config.hold.latency != self.config.hold.latency:
            self._delay = TorqueDelay(config.hold.latency, self.hand.joints)
        self.config, self._hold.config = config, config.hold
        self._law.configure(config.law)
        self._fitted_to = (0.0, 0)  # fit gains again
        self.warning, self._required = "", None
        if config.law.integral.time == 0.0:
            self._carried = self._none

    def reset(self) -> None:
        """Forget what was measured and commanded, and that the fingers are open."""
        self._regrasp.finish()
        self.forget()

    def forget(self) -> None:
        """Forget grasp, targets and integral; open or closing fingers continue."""
        self._law.reset()
        self._hold_with(np.ones(self.hand.fingers, dtype=bool))
        self._new_grasp()
        self._reference.reset()
        self._rates.reset()
        self.targets.reset()
        self._mode = Mode.NO_GRASP
        self._delay = TorqueDelay(self.config.hold.latency, self.hand.joints)
        self._sent = self._none  # at the last tick, N m
        self._last_torque: Array | None = None  # of the law, one tick ago
        self._last_stamp: int | None = None
        self._intervals = deque[float](maxlen=_INTERVALS)  # s between the last ticks
        self._hold.reset()
        self._accept_inputs()

    def _hold_with(self, touching: NDArray[np.bool_]) -> None:
        """Hold with the fingers in a mask of shape (k,)."""
        self._touching, self._fingers = touching, self.hand.part(touching)
        self._inputs = InputCheck(self._fingers)
        self._room: Array | None = None  # largest during the present move, see `room`
        self._shape = np.zeros((self._fingers.fingers, 3))  # the last f* with the touch of all
        self._late_touch = LateTouch(self._fingers)
        self._unfelt_touch = UnfeltTouch(self._fingers)
        self._unfelt = np.zeros(self._fingers.fingers, dtype=bool)  # of these: press, but unfelt

    def _new_grasp(self) -> None:
        self.warning, self._fitted_to, self._fitted_fingers = "", (0.0, 0), 0
        self._keeps_posture, self._pressing = False, NormalForceControl()
        self._carried = np.zeros(self.hand.joints)  # by the integral of law `grip`, N m
        self._required = None

    def _accept_inputs(self) -> None:
        self.touch_rejected = np.zeros(self.hand.fingers, dtype=bool)
        self._implausible_since: int | None = None  # tick of the first implausible input
        self._carries = False  # a load that acted on all contacts at the last tick, which it held

    def _enter(self, mode: Mode, theta: Array) -> None:
        """Change the state; a hold keeps the posture at its start, shape (m,), rad."""
        self._theta = theta
        if mode is self._mode:
            return
        # The spring of a kept posture carries the load.
        is_kept = self._keeps_posture and self._mode is Mode.DRIVE and mode is Mode.HOLD
        self._mode, self._last_torque = mode, None
        self._delay.pause()
        if mode is not Mode.DRIVE:
            self._reference.reset()
            if not is_kept:
                self._hold.posture = theta.copy()
        if mode in (Mode.OPEN, Mode.DISABLED):
            self._accept_inputs()
            self._hold.release()
        elif mode is Mode.HOLD:
            self._hold.engage(theta)

    def turn_palm(self, orientation: Array) -> None:
        """Turn gravity with the palm, by its quaternion (x, y, z, w) in the world, if `imu`."""
        if not self.config.imu:
            return
        self._palm = rotation_from_quaternion(orientation)
        self.hand.gravity = self._palm.T @ np.array(self.config.gravity)

    @property
    def missing(self) -> str:
        """Fingers without usable touch while the hand acts, and what they do; empty if none."""
        if self._mode is not Mode.DRIVE:
            return ""
        closing, unfelt = self.hand.part(~self._touching), self._fingers.part(self._unfelt)
        if closing.fingers:
            names = ", ".join(closing.finger_names)
            return f"no contact at {names}; closing, while the other fingers hold"
        names = ", ".join(unfelt.finger_names)
        return f"no usable touch at {names}; going on by its joints" if names else ""

    def release(self) -> None:
        """Open the fingers along the normals of the last grasp.

        Raises:
            GraspError: If there was no grasp yet.
        """
        if self._regrasp.active:
            self._regrasp.open()
            return
        grasp = self.targets.grasp
        if grasp is None:
            raise GraspError("there is no grasp to release; let all fingers touch first")
        self._regrasp.leave(self._theta, grasp.contacts)

    @property
    def is_open(self) -> bool:
        """Whether the fingers are open, opening or closing."""
        return self._regrasp.active

    def grasp(self) -> None:
        """Close open fingers until all touch, and start a new grasp.

        Raises:
            GraspError: If there was no grasp yet.
        """
        if self._regrasp.active:
            self._regrasp.close()
        elif self.targets.grasp is None:
            raise GraspError(
                "no grasp was made yet, so the way to close is unknown; bring all fingers to the "
                "object, and it is held"
            )

    def step(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts,
        optimal_forces: Array,
        grasp_force: float,
        forces: Array | None = None,
    ) -> Command:
        """Return the answer to a tick whose inputs have all arrived.

        Args:
            stamp: The tick, ns.
            joints: Report of the joints.
            contacts: Contacts by touch; NaN where there is none.
            optimal_forces: f* in contact frames, shape (k, 3); NaN if (13) has no solution.
            grasp_force: k_f, N.
            forces: Measured forces on the object, contact frames, shape (k, 3), N.
        """
        dt = self._elapsed(stamp)
        joints = self._with_rates(stamp, joints)
        self.targets.start_tick(self._last_stamp)
        if not self.enabled:
            return self._disabled(joints)
        if self._regrasp.active:
            if not self._regrasped(contacts):
                return self._open(joints, contacts, dt)
            dt = 0.0  # no time has passed in the new grasp
        self.touch_rejected = np.zeros(self.hand.fingers, dtype=bool)
        tick = _Tick(stamp, *joints, contacts, optimal_forces, grasp_force, forces, dt)
        held, now = self._holding_part(tick)
        problem = self._missing(contacts, now)
        if problem:
            self._carries = self._enough(now.contacts)
            self._inputs.start_grasp()
            self._implausible_since = None
            return self._holding(joints, problem, grasp_force)
        self._follow_touch(held, joints.theta)
        now, tips, problem = self._checked(now)
        if problem:
            return self._reject_inputs(stamp, joints, problem)
        self._implausible_since = None
        if not self._unfelt.any():
            self._unfelt_touch.feel(now.theta, now.contacts, now.forces)
            self._shape = now.optimal_forces
        try:
            return self._drive(now, tips, contacts)
        except GraspError as error:
            return self._holding(joints, str(error), grasp_force)

    def _with_rates(self, stamp: int, joints: Joints) -> Joints:
        """Return joints at a tick, ns, with rates from their angles if those have steps."""
        how = self.config.hold.resolution
        return joints._replace(rates=self._rates.step(stamp, joints.theta, joints.rates, how))

    def _holding_part(self, whole: _Tick) -> tuple[NDArray[np.bool_], _Tick]:
        """Return which fingers hold, shape (k,), and their input, the joints replacing lost touch.

        Where the touching fingers cannot hold alone, those that held before count: either they
        press unfelt, or they have left and nothing holds.
        """
        touching, before = whole.contacts.touching, self._touching
        if self._mode in (Mode.DRIVE, Mode.HOLD) and self._needs_unfelt(whole.contacts):
            self._unfelt = np.zeros(self._fingers.fingers, dtype=bool)
            now = whole.part(before)
            filled = self._with_unfelt(now, ~now.contacts.touching)
            if filled is not None or not self._enough(whole.contacts):
                return before, filled or now
        self._unfelt = np.zeros(int(touching.sum()), dtype=bool)
        return touching, whole.part(touching)

    def _with_unfelt(self, now: _Tick, unfelt: NDArray[np.bool_]) -> _Tick | None:
        """Return a tick with the touch of some fingers from their joints, and the last f* of all.

        The mask `unfelt` has the shape (k,) of the tick. None if touch is unknown. The torques are
        the sent ones, since reported ones may be what does not fit the touch.
        """
        torque = self._sent - self.hand.gravity_torque(now.theta)
        touch = self._unfelt_touch.filled(now.theta, now.contacts, now.forces, unfelt, torque)
        if touch is None:
            return None
        self._unfelt = unfelt
        return now._replace(contacts=touch[0], optimal_forces=self._shape, forces=touch[1])

    def _drive(self, now: _Tick, tips: Fingertips, contacts: Contacts) -> Command:
        """Return the answer of the law; `contacts` are those of all fingers that are felt.

        Raises:
            GraspError: If the law has no finite answer.
        """
        pose = self._law.auxiliary_pose(tips, now.contacts)
        if self._unfelt.any():
            contacts = contacts.replaced(self._touching, now.contacts)
        refused = self.targets.take_due(now.stamp, Grasp(now.theta, contacts, pose))
        assert self.targets.target is not None
        # The load that a hold has carried is to be carried from the first tick on; after a lost
        # contact, what is measured first is an impact.
        self._law.acts = not (self.joints_held or self._carries)
        self._carries = False
        passed = 0.0 if self.joints_held else now.elapsed  # the reference waits
        wanted = self._reference.step(self.targets.target, pose, self.config.reference_time, passed)
        refused = self._stopped(now, pose) or refused
        self._delay.step(None if self.joints_held else now.applied)
        self._fit(now)
        parts = self._law_torque(*self._acting(now, tips), wanted)
        self._enter(Mode.DRIVE, now.theta)
        internal = GraspTorque(self._none[:0], parts.internal)  # a hold will split it
        self._hold.held = Held(internal, parts.load_compensation, now.grasp_force)
        if now.elapsed > 0.0:  # the tick rate has been measured
            self._judge_hold(now)
        torque = self._sent = parts.within(self.hand.effort_limits, self._weight(now.theta))
        torque = self._ahead(torque, now.elapsed)
        if not self._touching.all():
            torque = self._closing(torque, now.theta, now.rates, now.contacts.centroid)
        self._delay.sent(torque)
        return Command(torque, Mode.DRIVE, pose, refused)

    def _acting(self, now: _Tick, tips: Fingertips) -> tuple[_Tick, Fingertips]:
        """Return joints, contacts and fingertips when the torque acts.

        A torque acts after its delay, for a tick: half a tick later on average. The joints move on
        by their rates. The contacts move with them since they were measured: a skin is late, and a
        slow one repeats its samples. Older directions would cost damping.
        """
        passes = now.elapsed > 0.0 and all_finite(now.rates)
        seen = now.rates if passes else None, tips, now.contacts
        limits = self.config.touch_latency, self.config.hold.resolution
        felt = ~self._unfelt
        since = self._late_touch.step(now.stamp, now.theta, *seen, felt, self._hold.period, *limits)
        ticks = (self._delay.ticks or 0) + (0.0 if self.config.midpoint_hold else 0.5)
        ahead = ticks * self._hold.period * now.rates if passes else self._none
        if not (since + ahead).any():
            return now, tips
        then = tips._replace(positions=tips.positions - tips.linear @ since)
        touch = now.contacts.positions, now.contacts.rotations
        contacts, theta = carried_along(then, *touch, since + ahead), now.theta + ahead
        now = now._replace(theta=theta, contacts=Contacts(*contacts))
        return now, self._fingers.fingertips(theta)

    def _law_torque(self, now: _Tick, tips: Fingertips, wanted: Target) -> LawTorque:
        """Return the torques of the law, without a drive where the grasp keeps its posture.

        Raises:
            GraspError: If they are not finite.
        """
        pressed = self._pressed(now)
        seen = LawInput(tips, now.contacts, now.optimal_forces, pressed)
        pose = self._law.auxiliary_pose(tips, now.contacts)
        parts = self._law.step(seen, now.rates, wanted, pose, now.elapsed, now.forces)
        if self._keeps_posture:
            parts = self._keeping(parts, now.theta, now.rates, now.elapsed)
        total = parts.total
        # One check for all torques: the square overflows only beyond those of any joint.
        if not math.isfinite(total.dot(total)):
            self._law.reset()
            raise GraspError(_NOT_FINITE)
        return parts

    def _pressed(self, now: _Tick) -> float:
        """Return the k_f to press with, N: for the law `grip` that which the skin measures."""
        c, grasp_force, forces = self.config, now.grasp_force, now.forces
        if c.law.name != "grip" or forces is None:
            return grasp_force
        age = c.touch_latency + (0.5 + self._delay.allowed) * self._hold.period
        passed = 0.0 if self.joints_held or self._unfelt.any() else now.elapsed
        limit, shown = c.law.integral.force_limit, (now.optimal_forces[:, 1], forces[:, 1])
        crush = c.grasp_force_limit if c.grasp_force_limit > 0.0 else math.inf
        ends = -min(limit, grasp_force), min(limit, crush - grasp_force)
        return self._pressing.step(grasp_force, *shown, *ends, passed, age)

    def _follow_touch(self, touching: NDArray[np.bool_], theta: Array) -> None:
        """Hold with the fingers in a mask of shape (k,); the torque of the law does not jump."""
        if (touching != self._touching).any():
            closed = self.hand.moves[touching & ~self._touching].any(axis=0)
            kept = self._hold.posture
            self._hold.posture = np.where(closed, theta, kept)  # where they touch again
            self._hold_with(touching)
            self._law.change_fingers()
            if self.config.law.name == "grip":
                self._fitted_fingers = 0  # its motions keep other contacts now

    def _closing(self, torque: Array, theta: Array, rates: Array, middle: Array) -> Array:
        """Return torques that close the fingers without contact, shape (m,), N m.

        Their tips move towards the centroid of the contacts, shape (3,), m, at a given speed. An
        obstacle that the skin does not detect meets only the damping to that speed.
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
        w, still = self._hold.bandwidth(inertia), np.zeros(hand.joints)
        closing = bias + spring(inertia, w, still, wanted - rates)
        limits = hand.effort_limits
        return np.where(jacobian.any(axis=0), np.clip(closing, -limits, limits), torque)

    def _checked(self, now: _Tick) -> tuple[_Tick, Fingertips, str]:
        """Return a tick, its fingertips, and why it is implausible; empty if it is not.

        If the touch of some fingers is, the others and the joints replace it.
        """
        pressing, c = None, self.config
        # Only forces that the law uses are compared.
        compares = c.law.observer.time > 0.0 and c.force_tolerance > 0.0
        if compares and now.forces is not None and now.applied is not None:
            pressing = now.forces, now.applied
        errors = c.touch_latency, self._rates.error
        limits = Tolerances(c.touch_tolerance, c.force_tolerance, *errors)
        seen = now.contacts, limits, pressing, self._palm
        tips, doubt = self._inputs.step(now.stamp, now.theta, now.rates, *seen)
        if doubt is not None and self._unfelt.any():
            self._unfelt_touch.lose()  # a finger that loses its object jolts the others
            return now, tips, doubt.reason
        if doubt is not None:
            replaced = self._with_unfelt(now, doubt.fingers)
            if replaced is None:
                self.touch_rejected[:] = True
                return now, tips, doubt.reason
            now, self.touch_rejected[self._touching] = replaced, doubt.fingers
        return now, tips, self._implausible(now.optimal_forces, now.grasp_force)

    def _stopped(self, now: _Tick, pose: AuxiliaryPose) -> str:
        """Return why the grasp stops here; empty if it moves on."""
        if not self._reference.is_moving:
            self._room = None
            return ""
        problem = self._way_ends(now)
        if not problem:
            return ""
        self._reference.reset()
        self.targets.stay(pose)
        return f"the move ends here: {problem}; go back, or ask for a smaller turn"

    def _way_ends(self, now: _Tick) -> str:
        """Return why a move must stop; empty if it may continue.

        A grasp may be firm at the start of a move and weak at its end. A growing grasp force is the
        sign of that. Moves back from a rim or an end are allowed.
        """
        limit = self.config.grasp_force_limit
        if 0.0 < _MOVES_UNTIL * limit < now.grasp_force:
            return (
                f"k_f = {now.grasp_force:.3g} N is near its limit of {limit:g} N, and the way "
                "ahead may need more"
            )
        left = room(self._fingers, now.theta, now.contacts)
        self._room = left if self._room is None else np.maximum(self._room, left)
        nearer = (left < self._room - 0.5 * LEAST_ROOM) & (self._room > 0.0)
        ends = np.flatnonzero((left < LEAST_ROOM) & nearer)
        return f"it brings {end_of(self._fingers, int(ends[0]))}" if len(ends) else ""

    def hold(
        self, joints: Joints, reason: str, grasp_force: float = 0.0, stamp: int | None = None
    ) -> Command:
        """Return the answer to a tick with a missing input: hold posture and grasp force.

        If a guard holds the joints, stiffer and without delay, the answer must not be sent. The
        held force rises with k_f, N, 0 if unknown, and never falls. With the tick `stamp`, ns, the
        rates are estimated from the angles, otherwise taken as measured. See `step`.
        """
        if stamp is not None:
            joints = self._with_rates(stamp, joints)
        self.targets.start_tick(self._last_stamp)
        self._implausible_since = None
        held = self._holding(joints, reason, grasp_force)
        return held._replace(do_not_send=self.joints_held)

    def _holding(self, joints: Joints, reason: str, grasp_force: float = 0.0) -> Command:
        """Hold posture and last good grasp force; see `hold`."""
        if not self.enabled:
            return self._disabled(joints)
        self._enter(Mode.HOLD, joints.theta)
        limit, weight = self.config.grasp_force_limit or math.inf, self._weight(joints.theta)
        risen = min(grasp_force, limit) if math.isfinite(grasp_force) else 0.0
        torque = self._hold.step(joints, weight, risen)
        return Command(torque, Mode.HOLD, None, reason)

    def _keeping(self, parts: LawTorque, theta: Array, rates: Array, dt: float) -> LawTorque:
        """Replace drive and damping of a law by the spring that keeps the posture.

        For the law `grip` an integral of the spring carries the load, in motions that keep the
        contacts: they do not change the grasp force, which the normal forces control.
        """
        inertia, c = self.hand.dynamics(theta, rates).inertia, self.config.law
        w, away = self._hold.bandwidth(inertia), self._hold.posture - theta
        still = np.zeros(len(theta))
        if c.name == "grip" and c.integral.time > 0.0 and not self.joints_held:
            pulled = spring(inertia, w, self._free @ away, still)
            carried = self._carried + dt / c.integral.time * (self._free @ pulled)
            self._carried = np.clip(carried, -c.integral.torque_limit, c.integral.torque_limit)
        load = parts.load_compensation + self._carried
        held = spring(inertia, w, away, -rates)
        return parts._replace(drive=held, damping=still, load_compensation=load)

    def _fit(self, now: _Tick) -> None:
        """Fit the gains that are not given to the hand, to the rate and delay of its torques.

        A gripper, or a hand that cannot place the object for want of joints, keeps its posture
        instead, by the spring of a hold: joint angles are newer than touch.

        This takes milliseconds, so a finger that loses and regains contact does not repeat it.
        """
        fingers, c, contacts = self._fingers.fingers, self.config, now.contacts
        if c.law.name == "grip":
            self._keep_posture(True, now.theta)
            if fingers != self._fitted_fingers:
                self._fitted_fingers = fingers
                self._free = kept_contacts(self._fingers, now.theta, contacts)
            return
        period, delay = self._fitted_to
        known = (
            abs(self._hold.period - period) <= _NEW_PERIOD * period and delay == self._delay.allowed
        )
        if self._law.fits or (known and fingers <= self._fitted_fingers):
            return
        self._fitted_to, self._fitted_fingers = (self._hold.period, self._delay.allowed), fingers
        self._required = None
        forces = contacts.centroid - contacts.positions  # of law (10), a guess for other laws
        if c.law.uses_optimal_forces:
            forces = in_palm(contacts.rotations, now.optimal_forces, 1.0)
        ages = c.touch_latency, c.law.observer.time
        how = forces, self._hold.period, *ages, c.hold.resolution, self._delay.allowed
        self._law.fit(fitted_gains(self._fingers, now.theta, contacts, *how))
        motions = motions_of_object(self._fingers, now.theta, contacts)
        self._keep_posture(motions < FEWEST_MOTIONS, now.theta)

    def _keep_posture(self, keeps: bool, theta: Array) -> None:
        """Keep the present posture, shape (m,), rad, unless one is kept already."""
        if keeps and not self._keeps_posture:
            self._hold.posture = theta.copy()
        self._keeps_posture = keeps

    def _judge_hold(self, now: _Tick) -> None:
        """Warn once per grasp if a hold could not keep it at this tick rate."""
        if not self.config.law.uses_optimal_forces or self.warning:
            return
        if self._required is None:
            forces = in_palm(now.contacts.rotations, now.optimal_forces, 1.0)
            buckling = buckling_rate(self._fingers, now.theta, now.contacts, forces)
            inertia = self.hand.dynamics(now.theta, self._none).inertia
            has = self._hold.bandwidth(inertia)
            self._required = required_bandwidth(buckling, self._hold.delay), has
        required, has = now.grasp_force * self._required[0], self._required[1]
        if required > has:
            rate = 1.0 / self._hold.period
            self.warning = (
                f"if inputs stop, this grasp would buckle: at {rate:.0f} Hz the hold has a "
                f"bandwidth of {has:.0f} rad/s, but k_f = {now.grasp_force:.3g} N needs "
                f"{required:.0f} rad/s; raise the rate to {rate * math.sqrt(required / has):.0f} Hz"
            )

    def _implausible(self, optimal_forces: Array, grasp_force: float) -> str:
        """Return why f* or k_f is implausible; empty if they are not."""
        c = self.config
        if 0.0 < c.grasp_force_limit < grasp_force:
            limit = f"grasp_force_limit = {c.grasp_force_limit:g} N"
            return f"k_f = {grasp_force:.3g} N is above {limit}; holding until it is not"
        return implausible_shape(optimal_forces) if c.law.uses_optimal_forces else ""

    def _reject_inputs(self, stamp: int, joints: Joints, reason: str) -> Command:
        """Answer a tick with an implausible input as if the input were missing."""
        if self._implausible_since is None:
            self._implausible_since = stamp
        is_new = 1e-9 * (stamp - self._implausible_since) < self.config.input_timeout
        held = self._holding(joints, reason)
        return held._replace(do_not_send=is_new or self.joints_held)

    def _disabled(self, joints: Joints) -> Command:
        theta, rates, _ = joints
        self._enter(Mode.DISABLED, theta)
        self._regrasp.follow(theta)
        self._hold.posture, damping = theta, self.config.law.damping
        torque = -damping * rates if damping > 0.0 else self._hold.spring(theta, rates)
        torque = torque + self._weight(theta)
        return Command(torque, Mode.DISABLED, None, "disabled by the user")

    def _regrasped(self, contacts: Contacts) -> bool:
        """Start a new grasp if closing fingers touch, and return whether they do.

        If enough fingers touch, the others first close as far as they may.
        """
        can_start = self._regrasp.closing and self._enough(contacts)
        if not can_start or self._regrasp.searches(contacts):
            return False
        self._regrasp.finish()
        self._law.reset()
        self.targets.start_grasp()
        self._hold_with(contacts.touching)
        self._new_grasp()
        return True

    def _needs_unfelt(self, contacts: Contacts) -> bool:
        """Return whether the others cannot hold without the fingers that held and are not felt."""
        if contacts.all_touching:
            return False
        lost = ~contacts.touching[self._touching]
        return not self._enough(contacts) or float(self._shape[lost, 1].sum()) > _OPPOSES

    def _enough(self, contacts: Contacts) -> bool:
        if self.config.law.uses_optimal_forces:
            return contacts.enough_touching
        return contacts.all_touching

    def _open(self, joints: Joints, contacts: Contacts, dt: float) -> Command:
        theta, rates, _ = joints
        self._enter(Mode.OPEN, theta)
        if self.joints_held:  # they do not follow
            self._regrasp.follow(theta)
            dt = 0.0
        self._hold.posture = self._regrasp.posture(contacts, dt)
        torque = self._hold.spring(theta, rates) + self._weight(theta)
        reason = self._regrasp.missed or "released by the user"
        return Command(torque, Mode.OPEN, None, reason)

    def _elapsed(self, stamp: int) -> float:
        """Return the time to integrate since the last tick, s; 0 after an interruption."""
        before, self._last_stamp = self._last_stamp, stamp
        if before is None or stamp <= before:
            return 0.0
        passed = 1e-9 * (stamp - before)
        self._intervals.append(passed)
        self._hold.period = sorted(self._intervals)[len(self._intervals) // 4]
        continues = self._mode is (Mode.OPEN if self._regrasp.active else Mode.DRIVE)
        return min(passed, _LONGEST_GAP) if continues else 0.0

    def _missing(self, contacts: Contacts, now: _Tick) -> str:
        """Return which input of the law is missing; empty if none is."""
        grasp_force, law = now.grasp_force, self.config.law
        if not (self._enough(contacts) or self._unfelt.any()):
            missing = ", ".join(self.hand.part(~contacts.touching).finger_names)
            return f"no contact at {missing}; holding until they touch again"
        if law.uses_optimal_forces and not all_finite(now.optimal_forces):
            return "no optimal force f*; holding until the optimizer has an answer"
        if not math.isfinite(grasp_force) or grasp_force < 0.0:
            return f"grasp force k_f = {grasp_force} N is unusable; holding the last grasp force"
        forces = now.forces if law.observer.time > 0.0 else None
        if forces is not None and np.isnan(forces[:, ::2]).any():
            return (
                "the skin does not measure tangential forces, which law.observer needs; use the "
                "law grip with such a skin"
            )
        return ""

    def _ahead(self, torque: Array, dt: float) -> Array:
        """Extrapolate a torque, shape (m,), N m, by half a period; it is T/2 old on average.

        `dt` is the time since the last tick, s.
        """
        last, self._last_torque = self._last_torque, torque
        if not self.config.midpoint_hold or last is None or dt <= 0.0:
            return torque
        return torque + 0.5 * self._hold.period / dt * (torque - last)

    def _weight(self, theta: Array) -> Array:
        """Return the torques that carry the links, shape (m,), N m; zero without compensation."""
        return self.hand.gravity_torque(theta) if self.config.gravity_compensation else self._none
