# SPDX-License-Identifier: Apache-2.0
"""A hand whose skin feels normal forces only holds an object, by torques and by position servos."""

import numpy as np
import pytest

from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.hand_config import DriverConfig
from tactile_hand_ros.control.driver_output import DriverOutput
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.scenario.scenario import load_scenario

PULL, STIFFNESS, DAMPING = 2.0, 2.0, 0.006  # s, N m/rad, N m s/rad: 30 % of critical
SLIPPERY = {"plant.object.friction": 0.25, "duration": 3.0}


def with_servos(strength: float):
    """Run position servos of another stiffness than their parameter, a factor; one tick late."""
    loop = ClosedLoop(load_scenario("ability", {"duration": 3.0, "plant.time_step": 0.00025}))
    output = DriverOutput(DriverConfig(output="position", stiffness=STIFFNESS), loop.plant.model)
    goal, limit = loop.state.joints.theta, loop.plant.hand.effort_limits

    def servo(_, theta, rates):
        return np.clip(strength * STIFFNESS * (goal - theta) - DAMPING * rates, -limit, limit)

    def advance(torque):
        nonlocal goal
        later = output.step(loop.state.joints.theta, torque)
        loop.drive(servo)
        goal = later

    loop.advance = advance
    record = loop.run()
    at, goal = loop.state.position, output.rest()
    for _ in range(1000):  # without commands
        loop.drive(servo)
    return record, float(np.linalg.norm(loop.state.position - at)), output.clipped


@pytest.mark.parametrize("strength", [0.7, 1.3])
def test_servos_of_unknown_strength_press_with_the_wanted_force_and_hold(strength):
    record, moved, clipped = with_servos(strength)
    wanted = record.grasp_force[:, None] * record.optimal_forces[:, :, 1]
    ratios = record.true_forces[:, :, 1] / wanted
    for last in (1900, -1):  # before the pull, and under it
        assert ratios[last].min() == pytest.approx(1.0, abs=0.02)
    assert record.grasp_force[1800:].max() == 12.0 and clipped == 0  # no slip is seen
    assert record.true_slid[-1].max() < 1e-4 and moved < 1e-4
    assert np.isnan(record.forces[:, :, ::2]).all() and np.isfinite(record.forces[:, :, 1]).all()


def test_a_second_without_commands_around_the_pull_costs_no_object():
    guarded = GuardedLoop(load_scenario("ability"))
    guarded.run(PULL - 0.5)
    at, watch = guarded.loop.state.position, Watch(guarded)
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
