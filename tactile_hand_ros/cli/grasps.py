# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand grasp HAND EDGE`: search for grasps, show the best, write a ready scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from tactile_hand_ros.cli.output import check_writable, print_files, print_table, steps
from tactile_hand_ros.errors import GraspError, TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.scene import hand_figure
from tactile_hand_ros.report.style import save
from tactile_hand_ros.scenario.grasp_search import number_of_starts, scenario_values, search
from tactile_hand_ros.simulation.plant_config import ObjectConfig

COLUMNS = ("", "load, N", "largest k_f, N", "friction needed", "room left, %")
_SHOWN = 5
_PART = 0.2  # of the load that can be held, the weight of an object; the rest is for pulls
_HEAVY = 0.2  # kg, the most that such an object weighs
_GRAVITY = 9.81  # m/s^2, along -z of the palm


def find_grasp(
    hand: str, edges: Sequence[float], shape: str, friction: float, mass: float, folder: Path
) -> None:
    """Search for grasps of an object, print the best, and write a scenario with a picture.

    `edges` [m] are one edge of a cube, diameter and length, or three edges of the box around it.
    A `mass` [kg] of 0 stands for a fifth of what the hand can hold, at most 0.2 kg.

    Raises:
        TactileHandError: If the edges or the hand cannot be used, or no grasp was found.
    """
    counts = (1, 3) if shape == "box" else (1, 2, 3)
    what = "" if shape == "box" else ", or diameter and length"
    expected = f"one or three positive lengths{what}"
    if len(edges) not in counts or not all(0.0 < edge < math.inf for edge in edges):
        raise TactileHandError(
            f"a {shape} of {list(edges)} m: expected {expected}, "
            f"such as `tactile-hand grasp {hand} 0.05`"
        )
    size = [edges[0], edges[min(1, len(edges) - 2)], edges[-1]]
    body = ObjectConfig().changed({"shape": shape, "size": size, "friction": friction})
    built = Hand.load(hand, gravity=np.array([0.0, 0.0, -_GRAVITY]))
    check_writable(folder)
    with steps("searching", number_of_starts(built, body)) as advance:
        found = search(built, body, advance=advance)
    best = found[0]
    rows = []
    for number, grasp in enumerate(found[:_SHOWN], 1):
        values = grasp.load, grasp.grasp_force, grasp.friction, 100.0 * grasp.room
        rows.append([str(number), *(f"{value:.2g}" for value in values)])
    print_table(f"{len(found)} grasps, the best first", COLUMNS, rows)
    if best.motions < 6:
        print(
            f"with {built.joints} joints, the hand moves the object in {best.motions} of 6 "
            "directions, and holds it in the others"
        )
    heaviest = best.load / _GRAVITY
    if mass > heaviest:
        raise GraspError(
            f"a {shape} of {mass:g} kg is too heavy: the best grasp carries {heaviest:.2g} kg "
            "before a joint reaches its torque limit; take a lighter one"
        )
    chosen = mass or min(_HEAVY, _PART * heaviest)
    print(f"with {chosen:.3g} kg, it bears pulls of up to {best.load - _GRAVITY * chosen:.2g} N")
    kind = "" if shape == "box" else f"{shape}_"
    edges = size if len(set(size)) > 1 else size[:1]
    name = f"{Path(hand).stem}_{kind}{'x'.join(f'{1e3 * edge:.0f}' for edge in edges)}mm"
    where = str(Path(hand).resolve()) if Path(hand).is_file() else hand
    scenario = scenario_values(where, body.changed({"mass": chosen}), best)
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(scenario, sort_keys=False), encoding="utf-8")
    drawn = hand_figure(built, best.theta, ObjectConfig(**scenario["plant"]["object"]))
    print_files([file, *save(drawn, folder, name)], folder)
    print(f"next: tactile-hand run {file}")
