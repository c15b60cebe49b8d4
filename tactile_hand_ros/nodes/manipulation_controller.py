# SPDX-License-Identifier: Apache-2.0
"""The manipulation controller: joint torques that hold and move the object.

Safe state: it holds the posture and the last good grasp force if f*, k_f or a contact that the
joints cannot replace or, with an observed load, a force is missing or NaN. It also holds if joint
states come without the other inputs for `input_timeout`; `/diagnostics` then names the missing
inputs. The hold ends when a tick is complete again. A malformed or unreachable desired pose is
counted and dropped, and the target stays. Without joint states the controller is silent. Then, and
when it crashes, the plant (or the drivers of a real hand) must hold the joints. Disabled by the
user, it only damps. A tick that fails for any other reason, or would give a non-finite torque, is
answered with the hold too. No torque exceeds the effort limits of the URDF.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.controller import Command, Controller, ControllerConfig, Mode
from tactile_hand_ros.control.grasp import best_rotation
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.margins import UNKNOWN_MARGINS, GraspMonitor
from tactile_hand_ros.errors import ConfigurationError, GraspError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.nodes.common import ModeLog, rotated_pose_encoder
from tactile_hand_ros.nodes.desired_poses import DesiredPoses
from tactile_hand_ros.nodes.user_changes import AppliedChanges
from tactile_hand_ros.own_law import take_law
from tactile_hand_ros.ros import qos, streams
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.endpoints import TickFailedError
from tactile_hand_ros.ros.messages import JointCodec, check_output
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import TickInputs

_TICK, _SLOW, _SHORT = 1_000_000, 1e-3, 1e-3  # ns, rad/s and m, of a rehearsal
_FULL = 1.0 - 1e-9  # of an effort limit; the law itself scales its torque to it, up to rounding
_AT_LIMIT = "a joint is at the effort limit of the URDF; lower the grasp force or the gains"


class ControllerReport:
    """Updates faults and values; nearly free while nothing changes."""

    def __init__(self, node: TactileNode[Any], hand: Hand) -> None:
        """Report on the grasp of a hand in the diagnostics of a node."""
        self._node = node
        self._watch = GraspMonitor(hand)
        self._modes = ModeLog(node.get_logger().info)
        self._theta: Array | None = None
        self._last: Command | None = None
        self._contacts: Contacts | None = None

    def reset(self) -> None:
        """Start with a new grasp."""
        self._watch.reset()

    def note(
        self, command: Command, theta: Array | None = None, contacts: Contacts | None = None
    ) -> None:
        """Record an answer with its joints and contacts, None if they were missing."""
        last, self._last = self._last, command
        self._theta, self._contacts = theta, contacts
        if last is not None and (command.mode, command.reason) == (last.mode, last.reason):
            return
        self._modes.note(command.mode.value, command.reason)
        diagnostics = self._node.diagnostics
        if command.mode is Mode.HOLD:
            if contacts is not None:  # missing inputs are already reported
                diagnostics.fault("hold", command.reason)
        elif command.mode in (Mode.DISABLED, Mode.OPEN):
            diagnostics.fault("hold", command.reason, WARN)
        else:
            diagnostics.clear("hold")
            if command.reason:  # a rejected pose whose tick has come
                self._node.reject(names.DESIRED_POSE, command.reason)

    def report(self, target: Target | None) -> None:
        """Add mode, distance to the target and margins of the grasp to the diagnostics."""
        put, last = self._node.diagnostics.value, self._last
        if last is None:
            return
        put("mode", last.mode.value)
        if last.pose is not None and target is not None:
            error = float(np.linalg.norm(target.position - last.pose.position))
            put("position_error_m", error)
        margins = UNKNOWN_MARGINS
        if self._contacts is not None and self._theta is not None:
            margins = self._watch.margins(self._theta, self._contacts)
        put("A1 face_travel_m", margins.face_travel)
        put("A2 hemisphere_margin_rad", margins.hemisphere)
        put("A5 joint_singularity_margin_m_per_rad", margins.joint)
        put("A7 collinearity_margin", margins.collinearity)


class ManipulationControllerNode(TactileNode[ControllerConfig]):
    """Answers each tick with joint torques.

    Subscriptions: `joint_states` (sensor_msgs/JointState, rad and rad/s), `tactile/contacts`
    (geometry_msgs/PoseArray, palm frame, m), `grasp_force` (geometry_msgs/WrenchStamped, k_f in
    force.y, N), `optimal_force/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`, f*,
    dimensionless), with `law.observer.time` > 0 or the law `grip` also `tactile/<finger>/wrench`
    (geometry_msgs/WrenchStamped in `<finger>_contact`, N), all with the same timestamp;
    `desired_pose` (geometry_msgs/PoseStamped, frame `palm`, m; takes effect at the tick in its
    timestamp, immediately if that is past or 0).

    Publications, with the timestamp of the input: `joint_command` (sensor_msgs/JointState, effort,
    N m), `auxiliary_pose` (geometry_msgs/PoseStamped, palm frame, m: centroid and virtual frame
    of the contacts; not while holding). With the timestamp of the first tick that they change:
    `accepted/desired_pose` (geometry_msgs/PoseStamped, frame `palm`, m) and the topics of
    `AppliedChanges`. At each change, latched: `touch_rejected` (std_msgs/String, fingers whose
    touch contradicts the joints, so that the regulator must not use it). Once a second:
    `/diagnostics` with mode, distance to the target and margins of A1 (travel on faces), A2 (tips'
    rims), A5 (joints) and A7 (contacts).

    At most 1000 poses wait for their tick; beyond that, the earliest are dropped and counted as
    `dropped_poses`. A pose stamped more than a day ahead of the ticks is rejected, at the latest at
    the first tick.

    Services: `~/reset` (std_srvs/Trigger) discards grasp, targets and integral, but fingers stay
    open or continue to close; timestamps that jump back reset these too. By std_srvs/SetBool:
    `~/enable` selects the law or mere damping, and `~/grasp` closes the fingers until all touch and
    then holds, or opens them.

    Parameters: the fields of `ControllerConfig`; gains are live, the law is not. A controller
    started with `law.observer.time` 0 rejects other values, because it does not subscribe to
    forces.
    """

    def __init__(self, *, composed: bool = False, time_waits: bool = False, **kwargs: Any) -> None:
        """Build the controller.

        With `composed`, a chain in this process calls `step` and sets `joints_held`, so that
        neither ticks nor `joint_hold` are received. With `time_waits`, time waits for each answer,
        so every answer must be sent; without a chain, a repeated tick shows this.
        """
        super().__init__("manipulation_controller", ControllerConfig, **kwargs)
        take_law(self.config.law)  # named by a parameter, so by the user
        self._controller = Controller(self.config)
        self._rehearse()
        self._report = ControllerReport(self, self._controller.hand)
        self._tick: int | None = None
        self._always_waits = self._time_waits = time_waits
        self._is_unsent = self._is_limited = False
        self._answer: tuple[int, Command] | None = None
        self._changes = AppliedChanges(self, names.CONTROLLER, commands=True)
        self._changes.begin(self.config)
        self._changes.state("enable", True)
        hand = self._controller.hand
        self._limits = hand.effort_limits
        torques, pose = JointCodec(hand.joint_names, ("effort",)).encode, rotated_pose_encoder()
        publisher = self.tick_publisher
        self._command_publisher = publisher(JointState, names.JOINT_COMMAND, torques)
        self._pose_publisher = publisher(PoseStamped, names.AUXILIARY_POSE, pose)
        # Created first, so that a waiting pose is handled before a waiting tick.
        self._desired = DesiredPoses(self, self._controller, lambda: self._tick)
        self._rejection = self.create_publisher(String, names.TOUCH_REJECTED, qos.latched_qos())
        self._rejection.publish(String())
        self._rejected = np.zeros(self.hand.fingers, dtype=bool)
        c = self.config
        is_grip = c.law.name == "grip"
        # The IMU is the last input of `on_tick`, after the forces, so it needs them too.
        self._takes_forces = composed or c.law.observer.time > 0.0 or c.imu or is_grip
        self.create_service(Trigger, names.RESET, self._on_reset)
        self.create_service(SetBool, names.ENABLE, self._on_enable)
        self.create_service(SetBool, names.GRASP, self._on_grasp)
        if not composed:
            self._receive()

    def _receive(self) -> None:
        hand = self._controller.hand
        held = qos.latched_qos(qos.USER_DEPTH)
        self.subscribe(Bool, names.JOINT_HOLD, self._on_joint_hold, profile=held)
        declared = [
            streams.joints(hand.joint_names),
            streams.contacts(hand.fingers),
            streams.grasp_force(),
            streams.optimal_forces(hand.finger_names),
        ]
        if self._takes_forces:
            declared.append(streams.forces(hand.finger_names))
        if self.config.imu:
            declared.append(streams.imu())
        self._inputs = TickInputs(self, declared, self, silence=self.config.input_timeout)

    def _rehearse(self) -> None:
        """Answer ticks of a moving grasp until the delay of torques is known: it loads all code."""
        hand, still = self._controller.hand, np.zeros(self._controller.hand.joints)
        contacts, forces = example_touch(hand.fingers)
        for stamp in range(0, (self.config.hold.latency + 3) * _TICK, _TICK):
            theta, rates = still + _SLOW * 1e-9 * stamp, still + _SLOW
            on_tips = hand.tip_positions(theta) + hand.radii[:, None] * contacts.normals
            touch = Contacts(on_tips, contacts.rotations)
            if stamp == _TICK:
                ahead = Target(touch.centroid + _SHORT, np.full((3, 3), np.nan))
                self._controller.targets.schedule(ahead, 0, judged=False)
            joints = Joints(theta, rates, still)
            self._controller.step(stamp, joints, touch, forces / hand.fingers, 1.0, forces)
        self._controller.hold(joints, "")
        GraspMonitor(hand).margins(still, touch)
        best_rotation(touch.positions, touch.positions)  # of a move whose contacts roll
        self._controller.reset()

    @property
    def hand(self) -> Hand:
        """The nominal hand of the controller."""
        return self._controller.hand

    @property
    def touch_rejected(self) -> NDArray[np.bool_]:
        """Fingers whose touch contradicts the joints, shape (k,)."""
        return self._controller.touch_rejected

    def turn_palm(self, orientation: Array) -> None:
        """Set the palm's orientation for gravity compensation; see `Controller.turn_palm`."""
        self._controller.turn_palm(orientation)

    @property
    def joints_held(self) -> bool:
        """Whether a guard holds the joints, so that no torque of this node reaches them."""
        return self._controller.joints_held

    @joints_held.setter
    def joints_held(self, held: bool) -> None:
        self._controller.joints_held = held
        self._changes.state(names.JOINT_HOLD, held)

    def check_config(self, config: ControllerConfig) -> None:
        """Reject a load observer without forces."""
        if config.law.observer.time > 0.0 and not self._takes_forces:
            raise ConfigurationError(
                f"law.observer.time = {config.law.observer.time}: the controller was started with "
                "0 and does not subscribe to forces; restart it with this value"
            )

    def on_config(self, config: ControllerConfig) -> None:
        """Apply changed gains."""
        self._controller.configure(config)
        self._changes.configuration(config)

    def on_rejected(self, source: str, reason: str) -> None:
        """Publish the reason for rejecting a command."""
        self._changes.rejected(source, reason)

    def on_report(self) -> None:
        """Report mode, distance to the target and the margins of the grasp."""
        self._report.report(self._controller.targets.target)
        warning = self._controller.warning
        self.diagnostics.judge("stiffness", bool(warning), warning, WARN)
        missing = self._controller.missing
        self.diagnostics.judge("contacts", bool(missing), missing, WARN)

    def _on_joint_hold(self, message: Bool) -> None:
        self.joints_held = message.data

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._desired.fresh.clear()
        self._controller.forget()
        self._start_over()
        self._changes.request("reset")
        response.success, response.message = True, "discarded grasp, targets and integral"
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._controller.enabled = request.data
        self._changes.state("enable", request.data)
        response.success, response.message = True, "enabled" if request.data else "damping only"
        return response

    def _on_grasp(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self._controller.grasp()
            else:
                self._controller.release()
        except GraspError as error:
            response.success, response.message = False, str(error)
            return response
        self._changes.request("grasp", request.data)
        closing = "closing" if self._controller.is_open else "the hand holds already"
        response.success, response.message = True, closing if request.data else "opening"
        return response

    def on_tick(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts,
        grasp_force: float,
        optimal_forces: Array,
        forces: Array | None = None,
        palm: Array | None = None,
    ) -> None:
        """Answer a complete tick."""
        if palm is not None:
            self.turn_palm(palm)
        self.step(stamp, joints, contacts, optimal_forces, grasp_force, forces)

    def step(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts,
        optimal_forces: Array,
        grasp_force: float,
        forces: Array | None = None,
    ) -> Command:
        """Publish and return the answer to a tick; see `Controller.step`.

        Raises:
            TickFailedError: If both this and the hold in its place failed.
        """
        self._answer = None
        try:
            with self.answering():
                if self._desired.fresh:
                    self._desired.before(stamp)
                self._tick = stamp
                touch = contacts, optimal_forces, grasp_force, forces
                command = self._controller.step(stamp, joints, *touch)
                rejected = self.touch_rejected
                if (rejected != self._rejected).any():
                    self._rejected = rejected
                    text = names.listed(self.hand.finger_names, rejected)
                    self._rejection.publish(String(data=text))
                command = self._send(stamp, command)
                self._desired.after(stamp)
                self._report.note(command, joints.theta, contacts)
        except TickFailedError as failure:
            command = self._safe_answer(stamp, joints, failure)
        return command

    def _safe_answer(self, stamp: int, joints: Joints, failure: TickFailedError) -> Command:
        """Return the answer sent before a failure; if there is none, hold the hand."""
        if self._answer is None:
            self.guarded("safe state", self.on_blind_tick)(stamp, joints, str(failure))
        if self._answer is None:
            raise failure
        return self._answer[1]

    def on_blind_tick(self, stamp: int, joints: Joints, reason: str) -> None:
        """Hold the hand at a tick with missing inputs."""
        command = self._controller.hold(joints, reason, stamp=stamp)
        if not command.do_not_send:
            self._send(stamp, command)
            self.diagnostics.tick()
        self._report.note(command)

    def on_repeat(self) -> None:
        """Publish the last answer again, or the unsent one: in lockstep, time waits for it."""
        self._time_waits = self._always_waits or self._is_unsent
        if self._answer is not None:
            stamp, command = self._answer
            self._command_publisher.publish(stamp, command.torque)

    def on_restart(self) -> None:
        """Reset when the ticks start over; keep poses that came with the first tick."""
        self._controller.reset()
        self._start_over()

    def _start_over(self) -> None:
        self._report.reset()
        self._changes.begin(self.config)
        self._desired.command_again()

    def _send(self, stamp: int, command: Command) -> Command:
        """Publish an answer within the joint limits unless it must not be sent, and return it.

        Raises:
            UnsafeOutputError: If a torque is not finite.
        """
        check_output(command.torque)
        self._is_unsent = command.do_not_send and not self._time_waits
        torque = self._limited(command.torque)
        if torque is not command.torque or command.do_not_send != self._is_unsent:
            command = command._replace(torque=torque, do_not_send=self._is_unsent)
        self._answer = stamp, command
        if self._is_unsent:
            return command
        self._command_publisher.publish(stamp, torque)
        self._changes.take_effect(stamp)
        if command.pose is not None:
            self._pose_publisher.publish(*command.pose, stamp)
        return command

    def _limited(self, torque: Array) -> Array:
        """Clip a torque to the joints' effort limits, and warn if one is reached."""
        is_full = bool((np.abs(torque) >= _FULL * self._limits).any())
        if is_full or self._is_limited:
            self.diagnostics.judge("torque", is_full, _AT_LIMIT, WARN)
        self._is_limited = is_full
        return np.clip(torque, -self._limits, self._limits) if is_full else torque
