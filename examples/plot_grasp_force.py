# SPDX-License-Identifier: Apache-2.0
"""Run the closed loop and plot grasp force and slip, with slip prevention on and off."""

import matplotlib.pyplot as plt

from tactile_hand_ros import simulate

figure, (force, slip) = plt.subplots(2, sharex=True, layout="constrained")
for mode, label in (("auto", "slip prevention on"), ("user", "slip prevention off")):
    result = simulate("human_pull", {"slip_regulator.mode": mode})
    record = result.record  # arrays, one row per tick
    force.plot(record.times, record.grasp_force, label=label)
    slip.plot(record.times, 1e3 * record.true_slid.max(axis=1))
    print(f"{label}: {result.headline}, at most {record.grasp_force.max():.1f} N")

force.set_ylabel("grasp force [N]")
force.legend()
slip.set_ylabel("longest slip [mm]")
slip.set_xlabel("time [s]")
figure.savefig("grasp_force.png")
print("grasp_force.png")
