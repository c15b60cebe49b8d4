# SPDX-License-Identifier: Apache-2.0
"""Run a scenario file with an object of your own, and see how heavy the object may become."""

from pathlib import Path

from tactile_hand_ros import simulate

SCENARIO = Path(__file__).with_name("own_object.yaml")

for mass in (0.15, 0.6, 2.4):  # kg
    result = simulate(str(SCENARIO), {"plant.object.mass": mass})
    slip = 1e3 * result.record.true_slid.max()
    force = result.record.grasp_force.max()
    print(f"{mass:g} kg: {result.headline}, slips {slip:.2f} mm, grasp force up to {force:.0f} N")

print(result.report())  # a page with 3D playback of the last run
