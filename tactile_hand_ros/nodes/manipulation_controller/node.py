# SPDX-License-Identifier: Apache-2.0
"""The manipulation controller: joint torques that hold and move the object.

Safe state: posture and last good squeeze are held when a contact, f*, k_f or, where the load is
observed, a force is missing or NaN, and, with the names of the missing inputs in `/diagnostics`,
when joint states come without them for `input_timeout`. The hold ends by itself when all inputs of
a tick are there again. A desired pose that is NaN, in another frame or out of reach is counted and
dropped, and the old one stays. Without joint states it says nothing; then, and when it dies, the
plant (or the drivers of a real hand) must hold the joints. Disabled by the user it only damps.
A tick at which anything else fails, or that would give a torque which is not finite, is answered
with the hold too. No torque exceeds the effort limits of the URDF.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tactile_hand_ros import names
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.controller import Command, Controller, ControllerConfig
from tactile_hand_ros.control.margins import GraspMonitor
from tactile_hand_ros.control.own_law import take_law
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.nodes.accepted import Accepted
from tactile_hand_ros.nodes.manipulation_controller.desired_poses import DesiredPoses
from tactile_hand_ros.nodes.manipulation_controller.report import ControllerReport
from tactile_hand_ros.nodes.manipulation_controller.services import ControllerServices
from tactile_hand_ros.nodes.publishers import report_publishers
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.messages.wire import JointCodec, PoseCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.ticks import streams
from tactile_hand_ros.ros.ticks.inputs import TickInputs
from tactile_hand_ros.ros.ticks.streams import Joints
from tactile_hand_ros.rotations import quaternion_from_rotation

Array = NDArray[np.float64]

_AT_LIMIT = "a joint is at the effort limit of the URDF; squeeze less or lower the gains"


class ManipulationControllerNode(TactileNode[ControllerConfig]):
    """Answers each tick with joint torques.

    Subscriptions: `joint_states` (sensor_msgs/JointState, rad and rad/s), `tactile/contacts`
    (geometry_msgs/PoseArray, palm frame, m), `grasp_force` (geometry_msgs/WrenchStamped, k_f in
    force.y, N), `optimal_force/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`, f*
    without unit), with `law.observer.time` > 0 also `tactile/<finger>/wrench`
    (geometry_msgs/WrenchStamped in `<finger>_contact`, N), all of one stamp; `desired_pose`
    (geometry_msgs/PoseStamped, frame `palm`, m; holds from the tick in its stamp on, at once when
    that is past or 0).

    Publications, with the stamps of the input: `joint_command` (sensor_msgs/JointState, effort,
    N m), `auxiliary_pose` (geometry_msgs/PoseStamped, palm frame, m: centroid and virtual frame
    of the contacts; not while holding). With the stamp of the first tick that they change:
    `accepted/desired_pose` (geometry_msgs/PoseStamped, frame `palm`, m) and what `Accepted` lists.
    At each change, latched: `touch_rejected` (std_msgs/Bool, whether joints and touch contradict
    each other, so that regulator and optimizer must not learn from touch). Once a second:
    `/diagnostics` with mode, distance to the target and margins of A1 (travel on faces), A2 (tips'
    rims), A5 (joints) and A7 (contacts).

    At most 1000 poses wait for their tick; of more the earliest are dropped and counted as
    `dropped_poses`. A pose that is stamped more than a day ahead of the ticks is refused, at the
    latest when the first of them comes.

    Services: `~/reset` (std_srvs/Trigger) forgets grasp, targets and integral, while open or
    closing fingers stay so; a jump back of the stamps forgets that too. By std_srvs/SetBool:
    `~/enable`, the law or mere damping, and `~/grasp`, close the fingers until all touch and hold
    that, or open them.

    Parameters: the fields of `ControllerConfig`; gains are live, the law is not. A controller that
    was started with `law.observer.time` 0 refuses another value: it does not subscribe to forces.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Build the controller.

        Raises:
            TactileHandError: If a parameter is refused or the hand cannot be built.
        """
        super().__init__("manipulation_controller", ControllerConfig, **kwargs)
        take_law(self.config.law)  # named by a parameter, so by the user
        self._controller = Controller(self.config)
        self._rehearse()
        self._report = ControllerReport(self, self._controller.hand)
        self._sent = b""
        self._is_withheld = self._time_waits = False
        self._unanswered: tuple[int, Joints] | None = None
        self._accepted = Accepted(self, names.CONTROLLER, requests=True, commands=True)
        self._begin()
        hand = self._controller.hand
        self._is_limited = False
        self._limits = hand.effort_limits
        self._commands = JointCodec(hand.joint_names, ("effort",))
        self._command_publisher = self.tick_publisher(JointState, names.JOINT_COMMAND)
        self._pose_codec = PoseCodec()
        self._pose_publisher = self.tick_publisher(PoseStamped, names.AUXILIARY_POSE)
        # First, so that of a pose and a tick that wait together the pose is handled first.
        self._desired = DesiredPoses(
            self, self._controller, lambda stamp: self._inputs.check_stamp(stamp)
        )
        held = qos.latched_qos(qos.user_qos().depth)
        self.subscribe(Bool, names.JOINT_HOLD, self._on_joint_hold, profile=held)
        self._doubt = self.create_publisher(Bool, names.TOUCH_REJECTED, qos.latched_qos())
        self._doubt.publish(Bool(data=False))
        self._doubted = False
        self._feels = self.config.law.observer.time > 0.0
        declared = (
            streams.joints(hand.joint_names),
            streams.contacts(hand.fingers),
            streams.grasp_force(),
            streams.optimal_forces(hand.finger_names),
            streams.forces(hand.finger_names, wanted=self._feels),
        )
        self._inputs = TickInputs(self, declared, self, silence=self.config.input_timeout)
        self._requests = ControllerServices(self, self._controller, self._accepted, self._on_reset)

    def _rehearse(self) -> None:
        hand = self._controller.hand
        contacts, forces = example_touch(hand.fingers)
        still = np.zeros(hand.joints)
        on_tips = hand.tip_positions(still) + hand.radii[:, None] * contacts.normals
        contacts = Contacts(on_tips, contacts.rotations)
        self._controller.step(0, still, still, contacts, forces / hand.fingers, 1.0, forces)
        GraspMonitor(hand).margins(still, contacts)
        self._controller.reset()

    def check_config(self, config: ControllerConfig) -> None:
        """Refuse to observe a load without forces."""
        if config.law.observer.time > 0.0 and not self._feels:
            raise ConfigurationError(
                f"law.observer.time = {config.law.observer.time}: the controller was started with "
                "0 and does not listen to forces; restart it with this value",
                place="law.observer.time",
            )

    def on_config(self, config: ControllerConfig) -> None:
        """Take other gains."""
        self._controller.configure(config)
        self._accepted.configuration(config)

    def on_rejected(self, source: str, reason: str) -> None:
        """Publish why a command was refused."""
        self._accepted.rejected(source, reason)

    def on_report(self) -> None:
        """Report mode, missing inputs, distance to the target and the margins of the grasp."""
        self._inputs.report()
        report_publishers(self, names.JOINT_STATES)
        self._report.report(self._controller.target)

    def _on_reset(self) -> None:
        self._desired.forget()
        self._controller.forget()
        self._start_over()

    def _on_joint_hold(self, message: Bool) -> None:
        if message.data != self._controller.joints_held:
            self._controller.joints_held = message.data
            self._accepted.request(names.JOINT_HOLD, message.data)

    def on_tick(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts,
        grasp_force: float,
        optimal_forces: Array,
        forces: Array | None,
    ) -> None:
        """Answer a tick for which everything has arrived; see `Controller.step`."""
        began = time.perf_counter()
        self._unanswered = stamp, joints
        self._desired.before(stamp)
        theta, rates, applied = joints
        command = self._controller.step(
            stamp, theta, rates, contacts, optimal_forces, grasp_force, forces, applied
        )
        self._publish_doubt()
        self._is_withheld = command.do_not_send and not self._time_waits
        if self._is_withheld:
            self._sent = self._encoded(stamp, command)
        else:
            self._answer(stamp, command)
        self._desired.after(stamp)
        self._report.note(command, joints.theta, contacts)
        self.diagnostics.latency(time.perf_counter() - began)

    def _publish_doubt(self) -> None:
        """Publish whether joints and touch do not fit each other, where that has changed."""
        if self._controller.touch_rejected != self._doubted:
            self._doubted = self._controller.touch_rejected
            self._doubt.publish(Bool(data=self._doubted))

    def on_blind_tick(self, stamp: int, joints: Joints, reason: str) -> None:
        """Hold the hand at a tick for which inputs are missing."""
        command = self._controller.hold(joints.theta, joints.rates, reason, applied=joints.applied)
        if not command.do_not_send:
            self._answer(stamp, command)
        self._report.note(command)

    def to_safe_state(self, reason: str) -> None:
        """Hold the hand at the tick that has failed."""
        if self._unanswered is not None:
            (stamp, joints), self._unanswered = self._unanswered, None
            self.on_blind_tick(stamp, joints, reason)

    def on_repeat(self) -> None:
        """Give the last answer again, or the one kept back: in lockstep time waits for it."""
        self._time_waits = self._is_withheld
        self._command_publisher.publish(self._sent)

    def on_restart(self) -> None:
        """Start over with the ticks; poses that came together with the first one are for it."""
        self._controller.reset()
        self._start_over()

    def _start_over(self) -> None:
        self._report.reset()
        self._begin()
        self._desired.command_again()

    def _begin(self) -> None:
        """Publish at the next tick what stays in force when the stamps start over."""
        self._accepted.begin(self.config)
        self._accepted.request("enable", self._controller.enabled)
        if self._controller.joints_held:
            self._accepted.request(names.JOINT_HOLD, True)

    def _answer(self, stamp: int, command: Command) -> None:
        self._sent = self._encoded(stamp, command)
        self._unanswered = None
        self._command_publisher.publish(self._sent)
        self._accepted.take_effect(stamp)
        self.diagnostics.tick()
        if command.pose is not None:
            turn = quaternion_from_rotation(command.pose.orientation)
            self._pose_publisher.publish(
                self._pose_codec.encode(command.pose.position, turn, stamp)
            )

    def _encoded(self, stamp: int, command: Command) -> bytes:
        return self._commands.encode(stamp, self._limited(command.torque))

    def _limited(self, torque: Array) -> Array:
        """Return a torque inside the joints' effort limits, and warn where it was not."""
        is_over = bool((np.abs(torque) > self._limits).any())
        if is_over:
            self.diagnostics.fault("torque", _AT_LIMIT, WARN)
        elif self._is_limited:
            self.diagnostics.clear("torque")
        self._is_limited = is_over
        return np.clip(torque, -self._limits, self._limits) if is_over else torque


def main(args: Sequence[str] | None = None) -> int:
    """Run the manipulation controller until SIGINT or SIGTERM and return the exit code."""
    return run_node(ManipulationControllerNode, args)


if __name__ == "__main__":
    sys.exit(main())
