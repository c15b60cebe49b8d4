# SPDX-License-Identifier: Apache-2.0
"""The plant: the simulated hand and object.

Safe state: a `CommandGuard` protects the joints, as in the driver of a real hand. In real time it
holds them when the newest command is more than `guard.age_limit` ticks old. In lockstep, where time
waits for the command, it holds them after `command_timeout` of silence, and time then follows the
wall clock. It also holds them while there are two senders of `joint_command` and when a joint
exceeds its speed limit. Commands with unknown joints, missing joints or NaN count as silence. A
hold keeps the grasp force and raises it with the load, brings the joints to rest, and sets the
level in `/diagnostics` to ERROR. Before the first command, time stops at the first tick. If the
simulation diverges, time stops too, with an ERROR, until `~/reset` and `~/run`. Without a plant
there are no ticks, and no node answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.control.grasp import required_friction
from tactile_hand_ros.nodes.plant.driver import InProcessHand, PlantDriver
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.messages import JointCodec, PushCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.simulation.plant_config import PlantConfig
from tactile_hand_ros.simulation.plant_run import PlantRun


class PlantNode(TactileNode[PlantConfig]):
    """Simulates hand and object, tick by tick.

    Publications, all stamped with the tick: `joint_states` (sensor_msgs/JointState, rad, rad/s and
    the torque that acted, N m), `ground_truth/contacts` (geometry_msgs/PoseArray, palm frame, m),
    `ground_truth/<finger>/wrench` (geometry_msgs/WrenchStamped, contact frame, N),
    `ground_truth/slip` (sensor_msgs/JointState by finger: distance slid, m, and sliding speed,
    m/s), `ground_truth/object_pose` (geometry_msgs/PoseStamped, palm frame, m), `clock`
    (rosgraph_msgs/Clock; `/clock` outside namespaces). Once: `robot_description`
    (std_msgs/String, URDF). At each change, latched: `joint_hold` (std_msgs/Bool, whether the
    guard holds the joints or commands are still taking over). Once a second: `/diagnostics`.

    Subscriptions: `joint_command` (sensor_msgs/JointState, effort by joint name, N m; stamped with
    the tick that it answers), `push` (geometry_msgs/WrenchStamped, frame `palm`: force and torque
    about the object's center of mass, N and N m; ends 0.2 s after its stamp).

    Services: `~/run` (std_srvs/SetBool) continues and pauses, `~/step` (std_srvs/Trigger) advances
    a paused run by one tick, `~/reset` (std_srvs/Trigger) goes back to the start at stamp 0.

    Parameters: the fields of `PlantConfig`; `object.friction`, `object.mass`, `palm_turn` and
    `speed` are live.
    """

    def __init__(self, *, composed: bool = False, **kwargs: Any) -> None:
        """Build hand and object, and start unless `autostart` is false.

        With `composed`, a hand in this process is passed to `begin` and answers the ticks, and no
        commands are received.
        """
        super().__init__("plant", PlantConfig, **kwargs)
        self._run = PlantRun(self.config)
        self._driver = PlantDriver(self, self._run)
        self._decode_push = PushCodec().decode
        self.subscribe(WrenchStamped, names.PUSH, self._on_push, profile=qos.USER_DEPTH, raw=True)
        self.create_service(Trigger, names.RESET, self._on_reset)
        self.create_service(SetBool, names.RUN, self._on_run)
        self.create_service(Trigger, names.STEP, self._on_step)
        self._driver.limit_speed(self.config.speed)
        if composed:
            self.work = self._driver.work
        else:
            self._joints = JointCodec(self._run.plant.hand.joint_names, ("effort",))
            self.subscribe(JointState, names.JOINT_COMMAND, self._on_command, raw=True)
            self._driver.begin()

    def begin(self, hand: InProcessHand) -> None:
        """Start with a hand in this process that answers the ticks."""
        self._driver.hand = hand
        self._driver.begin()

    def on_config(self, config: PlantConfig) -> None:
        """Apply a changed friction, mass, orientation or speed."""
        self._run.plant.configure(config)
        self._driver.limit_speed(config.speed)

    def to_safe_state(self, reason: str) -> None:
        """Hold the joints."""
        self._driver.to_safe_state(reason)

    def on_report(self) -> None:
        """Report mode, time, silence and the margins of contact."""
        put, state = self.diagnostics.value, self._run.state
        self._driver.report(put)
        put("touching", int(state.contacts.touching.sum()))
        put("required_friction", float(np.max(required_friction(state.forces), initial=0.0)))
        plant = self._run.plant
        put("contact_residual", plant.contact_residual)
        put("relaxed_steps", plant.relaxed_steps)
        put("unsolved_steps", plant.unsolved_steps)
        self.diagnostics.judge(
            "contact laws",
            plant.relaxed_steps + plant.unsolved_steps > 0,
            f"contact laws were relaxed in {plant.relaxed_steps} steps (jammed penetrations were "
            f"kept) and violated in {plant.unsolved_steps} since the start; lower friction or "
            "plant.time_step, or start without penetration",
            WARN,
        )

    def _on_command(self, data: bytes, info: Mapping[str, Any]) -> None:
        stamp, (torque,) = self._joints.decode(data)
        self._driver.command(stamp, torque, info)

    def _on_push(self, data: bytes) -> None:
        self._run.push(*self._decode_push(data))

    def _on_run(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = self._driver.switch(request.data)
        response.message = self._driver.mode
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        is_paused = self._driver.mode == "paused"
        response.success = is_paused and self._driver.switch(True, single=True)
        response.message = self._driver.mode if response.success else "the plant is not paused"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._driver.reset()
        response.success, response.message = True, self._driver.mode
        return response
