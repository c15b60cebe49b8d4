# SPDX-License-Identifier: Apache-2.0
"""The slip regulator: the grasp force k_f.

Safe state: in every mode it publishes k_f only for ticks with contacts and a force from every
finger. A finger that is silent or sends NaN leaves the tick without k_f, and the controller holds
the hand. If a finger that the grasp needs loses contact, the slip response doubles k_f once, and
k_f follows the load on the other fingers. k_f never exceeds `maximum`. `/diagnostics` warns if k_f
is at this limit, or if no grasp force can hold. A user request outside the limits is counted and
dropped, and k_f stays. If the node crashes, the controller holds the last grasp force. A new node
starts at the configured k_f, or outside mode `user` at the measured one if that is larger, and must
learn the friction again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState, JoyFeedback, JoyFeedbackArray
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import Trigger

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.control.margins import SlipMonitor
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.errors import UnsafeOutputError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.nodes.common import ModeLog
from tactile_hand_ros.nodes.user_changes import AppliedChanges
from tactile_hand_ros.ros import qos, streams
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly
from tactile_hand_ros.ros.messages import (
    JointCodec,
    WrenchCodec,
    WrenchPublishers,
    read_number,
)
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import TickInputs

_HAPTIC_PERIOD_NS = 20_000_000
"""Simulated time between two haptic messages [ns]; actuators run at 50 Hz."""

_UNHOLDABLE = (
    "no grasp force of this distribution can hold: a contact leaves its friction cone at any k_f; "
    "let the force_optimizer reshape it ('cones') or reduce the load"
)


class GripState(NamedTuple):
    """The regulator's estimates for each contact, arrays of shape (k,)."""

    friction: Array
    evidence: Array
    grip: NDArray[np.int_]

    @classmethod
    def of(cls, regulator: SlipRegulator) -> GripState:
        """Return the present estimates of a regulator."""
        return cls(regulator.learned_friction, regulator.slip_likelihood, regulator.state)


class RegulatorReport:
    """Reports the grip of each finger and detects when no permitted grasp force can hold.

    It warns in the modes `shared` and `auto` only; in `user` the user decides.
    """

    def __init__(self, diagnostics: Diagnostics, fingers: Sequence[str]) -> None:
        """Create a report on fingers with these names."""
        self._diagnostics, self._fingers = diagnostics, fingers
        self.reset()

    def reset(self) -> None:
        """Start over."""
        self._limited, self._unholdable, self._maximum_needed = Mostly(), Mostly(), 0.0
        self._watch = SlipMonitor()

    def note(
        self,
        regulator: SlipRegulator,
        stamp: int,
        contacts: Contacts,
        forces: Array,
        state: GripState,
    ) -> None:
        """Record a tick: measurements in contact frames and the regulator's estimates."""
        self._watch.note(stamp, contacts, forces, state.friction, state.grip, state.evidence)
        is_automatic = regulator.config.mode != "user"
        # k_f may be at the limit because of a past slip; that is no reason to warn.
        self._limited.note(is_automatic and regulator.config.maximum < regulator.needed < math.inf)
        self._unholdable.note(is_automatic and math.isinf(regulator.needed))
        if math.isfinite(regulator.needed):
            self._maximum_needed = max(self._maximum_needed, regulator.needed)

    def report(self, regulator: SlipRegulator) -> None:
        """Add mode, grasp forces and the grip of each finger to the diagnostics."""
        put = self._diagnostics.value
        put("mode", regulator.config.mode)
        put("grasp_force_n", regulator.grasp_force)
        put("needed_force_n", regulator.needed)
        facts = zip(self._fingers, *GripState.of(regulator), strict=True)
        for name, friction, evidence, grip in facts:
            put(f"friction {name}", float(friction))
            put(f"grip {name}", ContactState(grip).name.lower())
            put(f"slip_evidence {name}", float(evidence))
        watch = self._watch
        put("A3 load_n", watch.load)
        put("A4 slip_margin", watch.evidence)
        put("A4 cone_margin_n", watch.cone)
        put("A6 slip_time_left_s", watch.time_left)
        watch.clear()
        needed, maximum = self._maximum_needed, regulator.config.maximum
        self._maximum_needed = 0.0
        limited = (
            f"the object needs a grasp force of {needed:.3g} N, but the limit is {maximum:g} N; "
            "raise 'maximum' if the object can bear it, or reduce the load"
        )
        self._diagnostics.judge("limit", self._limited(), limited, WARN)
        self._diagnostics.judge("shape", self._unholdable(), _UNHOLDABLE, WARN)


class SlipRegulatorNode(TactileNode[SlipRegulatorConfig]):
    """Publishes the grasp force k_f and the grip of each finger at each tick.

    Subscriptions: `tactile/contacts` (geometry_msgs/PoseArray, palm frame, m),
    `tactile/<finger>/wrench` (geometry_msgs/WrenchStamped in `<finger>_contact`, N), `joint_states`
    (sensor_msgs/JointState, rad and N m), all with the same timestamp; `user_grasp_force`
    (std_msgs/Float64, the k_f that the user requests, N); `touch_rejected` (std_msgs/String,
    fingers whose touch the controller rejects); `joint_hold` (std_msgs/Bool, whether a guard holds
    the joints).

    Publications, with the timestamp of the input: `grasp_force` (geometry_msgs/WrenchStamped, k_f
    in force.y, N), `grip_state` (sensor_msgs/JointState by finger: learned friction, evidence for
    slip 0 to 1, `ContactState`), `load/<finger>` (geometry_msgs/WrenchStamped in
    `<finger>_contact`, load of the contact, N; NaN without a grasp), `grip_margin`
    (sensor_msgs/JointState by finger: usable friction, reserve for additional load in N). Every
    20 ms of simulated time: `haptic_feedback` (sensor_msgs/JoyFeedbackArray: id 0 grip as a
    fraction of the maximum, id 1 the strongest evidence for slip since the last message, both 0 to
    1). With the timestamp of the first tick that they change: `accepted/user_grasp_force`
    (geometry_msgs/WrenchStamped, an accepted k_f in force.y, N) and the topics of `AppliedChanges`.
    Once a second: `/diagnostics` with mode, k_f, the k_f that the object needs, friction and grip
    of each finger, and the worst margins of that second: A3 (load), A4 (evidence left before an
    alarm, distance to the estimated cones), A6 (time left to stop a slip).

    A node that lags answers only the newest ticks, but processes all of them.

    Service: `~/reset` (std_srvs/Trigger) returns to the configured k_f and discards all estimates,
    as timestamps that jump back do.

    Parameters: the fields of `SlipRegulatorConfig`; all but `hand` and `grasp_force` are live. The
    mode may change at any time; k_f then continues from its current value.
    """

    def __init__(self, *, composed: bool = False, **kwargs: Any) -> None:
        """Build the regulator.

        With `composed`, a chain in this process calls `step` and `reject_touch` and sets
        `joints_held`, so the node does not subscribe to these inputs.
        """
        super().__init__("slip_regulator", SlipRegulatorConfig, **kwargs)
        self._regulator = SlipRegulator(self.config)
        self._fresh: float | None = None  # k_f requested since the last tick, N
        hand = self._regulator.hand
        fingers = self._fingers = hand.finger_names
        self._changes = AppliedChanges(self, names.REGULATOR, commands=True)
        self._report = RegulatorReport(self.diagnostics, fingers)
        self._modes = ModeLog(self.get_logger().info)
        self._modes.note(self.config.mode)
        self._rehearse(hand)
        grips = JointCodec(fingers).encode
        self._grip_publisher = self.tick_publisher(JointState, names.GRIP_STATE, grips)
        margins = JointCodec(fingers, ("position", "effort")).encode
        self._margin_publisher = self.tick_publisher(JointState, names.GRIP_MARGIN, margins)
        self._load_publishers = WrenchPublishers(self, fingers, names.load, nan_allowed=True)
        self._encode = WrenchCodec(names.PALM_FRAME).encode
        self._publisher = self.tick_publisher(WrenchStamped, names.GRASP_FORCE, self._encode)
        self._haptic_publisher = self.create_publisher(
            JoyFeedbackArray, names.HAPTIC_FEEDBACK, qos.USER_DEPTH
        )
        self._haptic_period, self._strongest = -1, 0.0
        self._force_publisher = self.create_publisher(
            WrenchStamped, names.ACCEPTED_FORCE, qos.USER_DEPTH
        )
        self.subscribe(
            Float64, names.USER_GRASP_FORCE, self._on_user_force, profile=qos.USER_DEPTH, raw=True
        )
        self.create_service(Trigger, names.RESET, self._on_reset)
        if not composed:
            latched = qos.latched_qos(qos.USER_DEPTH)
            self.subscribe(String, names.TOUCH_REJECTED, self._on_touch_rejected, profile=latched)
            self.subscribe(Bool, names.JOINT_HOLD, self._on_joint_hold, profile=latched)
            touch = streams.contacts(hand.fingers), streams.forces(fingers)
            declared = (*touch, streams.joints(hand.joint_names))
            self._inputs = TickInputs(self, declared, self, observe=self.observe)

    @property
    def carried(self) -> CarriedLoad:
        """The load that f* must carry; see `SlipRegulator`."""
        return self._regulator.carried

    def _rehearse(self, hand: Hand) -> None:
        touch, regulator = example_touch(hand.fingers), self._regulator
        still = np.zeros(hand.joints)
        for stamp in (0, 1):  # the second knows the load
            regulator.step(stamp, Joints(still, still, still), *touch)
        self._report.note(regulator, 0, *touch, GripState.of(regulator))
        self.on_restart()

    def on_config(self, config: SlipRegulatorConfig) -> None:
        """Apply a changed mode, limits and rates."""
        self._modes.note(config.mode)
        self._regulator.configure(config)
        self._changes.configuration(config)

    def on_rejected(self, source: str, reason: str) -> None:
        """Publish the reason for rejecting a command."""
        self._changes.rejected(source, reason)

    def on_report(self) -> None:
        """Report k_f and the estimates for the contacts."""
        self._report.report(self._regulator)

    def on_restart(self) -> None:
        """Reset when the ticks start over."""
        self._regulator.reset()
        self._report.reset()
        self._changes.begin(self.config)
        if self._fresh is not None:  # requested before the plant continued
            self._request(self._fresh)

    def _on_user_force(self, data: bytes) -> None:
        self._request(read_number(data))

    def _request(self, force: float) -> None:
        self._regulator.request(force)
        self._fresh = force
        self._changes.add(self._force_publisher, partial(self._encode, (0.0, force, 0.0)))

    def reject_touch(self, rejected: NDArray[np.bool_]) -> None:
        """Set the fingers whose touch the controller rejects, shape (k,); see `SlipRegulator`."""
        if self._changes.state(names.TOUCH_REJECTED, names.listed(self._fingers, rejected)):
            self._regulator.reject_touch(rejected)

    def _on_touch_rejected(self, message: String) -> None:
        self.reject_touch(np.array(names.is_listed(self._fingers, message.data)))

    @property
    def joints_held(self) -> bool:
        """Whether a guard holds the joints, so that no k_f reaches them."""
        return self._regulator.joints_held

    @joints_held.setter
    def joints_held(self, held: bool) -> None:
        if self._changes.state(names.JOINT_HOLD, held):
            self._regulator.joints_held = held

    def _on_joint_hold(self, message: Bool) -> None:
        self.joints_held = message.data

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._fresh = None
        self.on_restart()
        self._changes.request("reset")
        response.success, response.message = True, f"k_f = {self._regulator.grasp_force:g} N"
        return response

    def on_tick(self, stamp: int, contacts: Contacts, forces: Array, joints: Joints) -> None:
        """Answer a complete tick."""
        self.step(stamp, joints, contacts, forces)

    def step(self, stamp: int, joints: Joints, contacts: Contacts, forces: Array) -> float:
        """Publish grip, load and k_f and return k_f; see `SlipRegulator.step`."""
        self._fresh = None
        with self.answering():
            regulator, maximum = self._regulator, self.config.maximum
            grasp_force = regulator.step(stamp, joints, contacts, forces)
            if not 0.0 <= grasp_force <= maximum:
                raise UnsafeOutputError(
                    f"k_f = {grasp_force} N is outside 0 to {maximum} N and was not published; "
                    "call ~/reset"
                )
            state = GripState.of(regulator)
            self._grip_publisher.publish(stamp, *state)
            load, friction, reserve = regulator.carried
            self._margin_publisher.publish(stamp, friction, reserve)
            self._load_publishers.publish(stamp, load)
            self._publisher.publish((0.0, grasp_force, 0.0), stamp)
            self._changes.take_effect(stamp)
            self._report.note(regulator, stamp, contacts, forces, state)
            self._publish_haptics(stamp, grasp_force / maximum, float(state.evidence.max()))
        return grasp_force

    def observe(self, stamp: int, contacts: Contacts, forces: Array, joints: Joints) -> None:
        """Process a skipped tick, because slip detection needs every sample."""
        self._fresh = None
        self._regulator.step(stamp, joints, contacts, forces)
        self._changes.take_effect(stamp)

    def _publish_haptics(self, stamp: int, grip: float, slip: float) -> None:
        self._strongest = max(self._strongest, slip)
        if stamp // _HAPTIC_PERIOD_NS != self._haptic_period:
            self._haptic_period = stamp // _HAPTIC_PERIOD_NS
            rumbles = [
                JoyFeedback(type=JoyFeedback.TYPE_RUMBLE, id=number, intensity=intensity)
                for number, intensity in enumerate((grip, self._strongest))
            ]
            self._haptic_publisher.publish(JoyFeedbackArray(array=rumbles))
            self._strongest = 0.0
