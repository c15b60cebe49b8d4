# SPDX-License-Identifier: Apache-2.0
"""Read a bag into pandas: python examples/read_bag.py [run or bag]; runs/latest by default."""

import sys

from tactile_hand_ros import Run

run = Run(*sys.argv[1:])
frame = run.to_pandas()  # one row per tick, indexed by time in s; needs `pip install pandas`
print(f"{len(frame)} ticks, {len(frame.columns)} columns, {run.headline or 'no goal'}")

normal = frame.filter(regex=r"^forces\..*\.y$")  # of each finger; y is the normal
print(normal.describe().loc[["mean", "std", "max"]].round(3))

print(frame.attrs["meaning"]["grasp_force"])
print(frame["grasp_force"].groupby(frame.index // 0.1 * 0.1).mean().round(3).head())

for event in run.events:
    print(event)
