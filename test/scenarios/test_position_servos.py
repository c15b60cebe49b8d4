# SPDX-License-Identifier: Apache-2.0
"""A hand whose driver takes positions holds the cube as one that takes torques."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.hand_config import DriverConfig
from tactile_hand_ros.control.driver_output import DriverOutput
from tactile_hand_ros.scenario.scenario import load_scenario

STIFFNESS, DAMPING = 5.0, 0.003  # N m/rad, N m s/rad: 7 % of critical at the base
LATE = {"manipulation_controller.hold.latency": 1}  # ticks, of a servo
SCENARIO = load_scenario("human_hold", {"duration": 2.0, "plant.time_step": 0.00025, **LATE})


class ServoLoop(ClosedLoop):
    """Position servos, which take four steps per tick and commands that are one tick late."""

    def advance(self, torque: NDArray[np.float64]) -> None:
        if not self.stamp:
            driver = DriverConfig(output="position", stiffness=STIFFNESS)
            self.output, self.goal = DriverOutput(driver, self.plant.model), self.state.joints.theta
        goal = self.output.step(self.state.joints.theta, torque)
        self.servo()
        self.goal = goal

    def servo(self) -> None:
        def torque_of(_: int, theta: NDArray[np.float64], rates: NDArray[np.float64]) -> NDArray:
            return np.clip(STIFFNESS * (self.goal - theta) - DAMPING * rates, -limit, limit)

        limit = self.plant.hand.effort_limits
        self.drive(torque_of)


def test_position_servos_hold_the_object_with_the_same_grasp_force() -> None:
    """Up to encoder steps e of two ticks, torques of k e: forces of k e / 30 mm at three tips."""
    servos, direct, last = ServoLoop(SCENARIO), ClosedLoop(SCENARIO).run(), slice(1000, None)
    held = servos.run()
    tolerance = 2.0 * 3.0 * STIFFNESS * (2.0 * np.pi / 2.0**16) / 0.03  # 0.1 N
    assert abs(held.grasp_force[last].mean() - direct.grasp_force[last].mean()) < tolerance
    assert held.true_slid.max() < 1e-6 and servos.output.clipped == 0
    servos.goal = servos.output.rest()
    for _ in range(500):  # without commands
        servos.servo()
    assert servos.state.slid.max() < 1e-6
