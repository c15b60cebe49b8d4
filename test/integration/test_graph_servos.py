# SPDX-License-Identifier: Apache-2.0
"""The graph with `driver_output` and position servos: the Ability Hand grips by normal forces."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from support.graph import Graph
from support.messages import joint_message, stamp_to_ns

from bench.processes import isolated_domain, parameter_files
from tactile_hand_ros import names
from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.ros import qos
from tactile_hand_ros.scenario.scenario import load_scenario

STIFFNESS, DAMPING = 2.0, 0.006  # N m/rad, N m s/rad
PULL = {"kind": "step", "start": 0.8, "force": [0.0, 0.0, -2.0]}
CHANGES = {"duration": 86400, "plant.autostart": False, "plant.disturbances": [PULL]}
CHANGES |= {"plant.command_timeout": 60.0}  # a slow computer must not count as silence


class ServoGraph(Graph):
    """A graph whose torques reach the joints through `driver_output` and position servos.

    The servos answer a tick when its goal has come, or, while `free`, immediately with the last
    goal, as servos do when nothing comes any more.
    """

    goal: np.ndarray | None = None
    goal_stamp, free = -1, False

    def start(self, name):
        remap = ["-r", "joint_command:=torque"] if name == names.CONTROLLER else []
        return self._enter(name, *remap, *parameter_files(self.scenario, self._folder, [name]))

    def _talk(self):
        super()._talk()
        driver = f"driver: {{topic: goals, output: position, stiffness: {STIFFNESS}}}\n"
        file = self._folder / "ability.yaml"
        file.write_text(find_file("hand", "ability").read_text() + driver)
        # In lockstep a slow computer must not count as silence.
        where = "-p", f"hand:={file}", "-p", "rate:=10.0", "-r", "joint_command:=torque"
        self._enter("driver_output", *where)
        self.hand = Hand.load("ability")
        self.states = JointState()
        make = self.node.create_subscription
        make(JointState, names.JOINT_STATES, self._on_states, qos.TICK_DEPTH)
        make(JointState, "goals", self._on_goal, qos.TICK_DEPTH)
        self.torques = self.node.create_publisher(JointState, names.JOINT_COMMAND, qos.TICK_DEPTH)

    def _on_states(self, message):
        self.states = message
        self._act()

    def _on_goal(self, message):
        by_name = dict(zip(message.name, message.position, strict=True))
        self.goal = np.array([by_name[name] for name in self.hand.joint_names])
        self.goal_stamp = stamp_to_ns(message.header.stamp)
        self._act()

    def _act(self):
        stamp = stamp_to_ns(self.states.header.stamp)
        if self.goal is None or not (self.free or stamp == self.goal_stamp):
            return
        index = [self.states.name.index(name) for name in self.hand.joint_names]
        theta, rates = (np.array(x)[index] for x in (self.states.position, self.states.velocity))
        torque = STIFFNESS * (self.goal - theta) - DAMPING * rates
        torque = np.clip(torque, -self.hand.effort_limits, self.hand.effort_limits)
        self.torques.publish(joint_message(self.hand.joint_names, stamp, effort=torque))


def test_position_servos_keep_the_object_by_normal_forces_also_without_a_controller(tmp_path):
    scenario = load_scenario("ability", CHANGES)
    with isolated_domain() as domain, ServoGraph(scenario, domain, tmp_path) as graph:
        refusals, thumb = list[DiagnosticArray](), list[WrenchStamped]()
        hear = graph.node.create_subscription
        hear(DiagnosticArray, names.rejected(names.CONTROLLER), refusals.append, qos.USER_DEPTH)
        hear(WrenchStamped, names.wrench("thumb"), thumb.append, qos.TICK_DEPTH)
        graph.begin()
        graph.wait(lambda: graph.time > 1.5, "the pull")
        force = thumb[-1].wrench.force
        assert np.isnan([force.x, force.z]).all() and force.y == pytest.approx(6.0, abs=0.3)
        assert np.isfinite(graph.contacts).all()
        assert graph.newest(names.GRASP_FORCE).wrench.force.y == 12.0
        assert graph.health["/driver_output"].values["clipped_outputs"] == "0"
        graph.desire([0.0, 0.0, 0.1])
        graph.wait(lambda: refusals, "a refusal")
        assert "normal forces do not show a load" in refusals[0].status[0].message
        graph.processes[names.CONTROLLER].send(signal.SIGSTOP)
        graph.free = True
        graph._act()
        at, until = graph.position(), graph.time + 1.0
        graph.wait(lambda: graph.time > until, "a second without a controller")
        assert np.linalg.norm(graph.position() - at) < 1e-3
        graph.free = False
        graph.processes[names.CONTROLLER].send(signal.SIGCONT)
        graph.wait(lambda: graph.time > until + 0.2, "its return")
        assert np.isfinite(graph.contacts).all()
        assert np.linalg.norm(graph.position() - at) < 2e-3
        assert set(graph.end(signal.SIGINT).values()) == {0}
