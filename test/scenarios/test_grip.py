# SPDX-License-Identifier: Apache-2.0
"""Hands with position servos, and with a skin for normal forces only, hold an object."""

import numpy as np
import pytest
from support.outcomes import watched

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.hand_config import DriverConfig
from tactile_hand_ros.control.driver_output import DriverOutput
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.scenario.scenario import load_scenario

PULL = 2.0  # s
SLIPPERY = {"plant.object.friction": 0.25, "duration": 3.0}
STEP = {"plant.time_step": 0.00025}  # four steps of a servo per tick


class ServoLoop(ClosedLoop):
    """Position servos, whose commands are one tick late; see `DriverOutput`."""

    def __init__(self, scenario, stiffness, damping, strength=1.0):
        """Make servos [N m/rad, N m s/rad] that are stiffer than their parameter by a factor."""
        super().__init__(scenario)
        driver = DriverConfig(output="position", stiffness=stiffness)
        self.output, self.goal = DriverOutput(driver, self.plant.model), self.state.joints.theta
        self.stiffness, self.damping = strength * stiffness, damping

    def advance(self, torque):
        goal = self.output.step(self.state.joints.theta, torque)
        self.drive(self.servo)
        self.goal = goal

    def servo(self, _, theta, rates):
        torque = self.stiffness * (self.goal - theta) - self.damping * rates
        return np.clip(torque, -self.plant.hand.effort_limits, self.plant.hand.effort_limits)

    def rest(self, ticks):
        """Go on without commands."""
        self.goal = self.output.rest()
        for _ in range(ticks):
            self.drive(self.servo)


def test_position_servos_hold_the_object_with_the_same_grasp_force():
    """Up to encoder steps e of two ticks, torques of k e: forces of k e / 30 mm at three tips."""
    late = {"manipulation_controller.hold.latency": 1}  # ticks, of a servo
    scenario = load_scenario("human_hold", {"duration": 2.0, **STEP, **late})
    stiffness, last = 5.0, slice(1000, None)
    servos = ServoLoop(scenario, stiffness, 0.003)  # 7 % of critical at the base
    held, direct = servos.run(), ClosedLoop(scenario).run()
    tolerance = 2.0 * 3.0 * stiffness * (2.0 * np.pi / 2.0**16) / 0.03  # 0.1 N
    assert abs(held.grasp_force[last].mean() - direct.grasp_force[last].mean()) < tolerance
    assert held.true_slid.max() < 1e-6 and servos.output.clipped == 0
    servos.rest(500)
    assert servos.state.slid.max() < 1e-6


@pytest.mark.parametrize("strength", [0.7, 1.3])
def test_servos_of_unknown_strength_press_with_the_wanted_force_and_hold(strength):
    loop = ServoLoop(load_scenario("ability", {"duration": 3.0, **STEP}), 2.0, 0.006, strength)
    record, at = loop.run(), loop.state.position
    loop.rest(1000)
    wanted = record.grasp_force[:, None] * record.optimal_forces[:, :, 1]
    ratios = record.true_forces[:, :, 1] / wanted
    for last in (1900, -1):  # before the pull, and under it
        assert ratios[last].min() == pytest.approx(1.0, abs=0.02)
    assert record.grasp_force[1800:].max() == 12.0 and loop.output.clipped == 0  # no slip is seen
    assert record.true_slid[-1].max() < 1e-4
    assert np.linalg.norm(loop.state.position - at) < 1e-4
    assert np.isnan(record.forces[:, :, ::2]).all() and np.isfinite(record.forces[:, :, 1]).all()


def test_a_second_without_commands_around_the_pull_costs_no_object():
    guarded, watch = watched(load_scenario("ability"), PULL - 0.5)
    at = guarded.loop.state.position
    watch.run(1.0, answers=False)
    watch.run(1.0)
    state = guarded.loop.state
    assert state.contacts.all_touching and watch.slid < 5e-4
    assert np.linalg.norm(state.position - at) < 2e-3


def test_a_slip_seen_in_normal_forces_raises_the_grasp_force_in_time():
    found, without = (
        simulate("ability", SLIPPERY | {"slip_regulator.mode": mode}) for mode in ("shared", "user")
    )
    assert without.metrics.is_dropped
    assert not found.metrics.is_dropped and found.metrics.max_slip_distance_m < 1e-3
    assert found.metrics.final_grasp_force_N == 24.0
    np.testing.assert_array_equal(found.record.friction, 0.4)  # it cannot be learned
