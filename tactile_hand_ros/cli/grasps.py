# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand grasp HAND EDGE`: search for grasps, show the best, write a ready scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from tactile_hand_ros.cli.output import check_writable, print_files, print_table, steps
from tactile_hand_ros.control.holds import motions_of_object
from tactile_hand_ros.errors import GraspError, TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.scene import hand_figure
from tactile_hand_ros.report.style import save
from tactile_hand_ros.scenario.grasp_search import (
    FoundGrasp,
    number_of_starts,
    scenario_values,
    search,
)
from tactile_hand_ros.simulation.plant_config import ObjectConfig

COLUMNS = ("", "load, N", "largest k_f, N", "friction needed", "room left, %")
_SHOWN = 5
_PART = 0.2  # of the load that can be held, the weight of a box; the rest is for pulls
_HEAVY = 0.2  # kg, the most that such a box weighs
_GRAVITY = 9.81  # m/s^2, along -z of the palm


def find_grasp(
    hand: str, edges: Sequence[float], friction: float, mass: float, folder: Path
) -> None:
    """Search for grasps of a box, print the best, and write a scenario with a picture.

    Args:
        hand: Name or YAML file.
        edges: One edge of a cube or three of a box, m.
        friction: Friction coefficient.
        mass: Mass of the box, kg; 0 for a fifth of what the hand can hold, at most 0.2 kg.
        folder: For the files.

    Raises:
        TactileHandError: If the edges or the hand cannot be used, or no grasp was found.
    """
    if len(edges) not in (1, 3) or not all(0.0 < edge < math.inf for edge in edges):
        raise TactileHandError(
            f"the box has the edges {list(edges)}, expected one or three positive lengths in m, as "
            f"`tactile-hand grasp {hand} 0.05`"
        )
    x, y, z = (*edges, *edges, *edges)[:3]
    size, built = (x, y, z), Hand.load(hand, gravity=np.array([0.0, 0.0, -_GRAVITY]))
    check_writable(folder)
    with steps("searching", number_of_starts(built, size)) as advance:
        found = search(built, size, friction, advance=advance)
    best = found[0]
    print_table(
        f"{len(found)} grasps, the best first",
        COLUMNS,
        [_row(i, g) for i, g in enumerate(found[:_SHOWN], 1)],
    )
    motions = motions_of_object(built, best.theta, best.contacts)
    if motions < 6:
        print(
            f"with {built.joints} joints, the hand moves the object in {motions} of 6 directions, "
            "and holds it in the others"
        )
    heaviest = best.load / _GRAVITY
    if mass > heaviest:
        raise GraspError(
            f"a box of {mass:g} kg is too heavy: the best grasp carries {heaviest:.2g} kg before a "
            "joint reaches its torque limit; take a lighter one"
        )
    chosen = mass or min(_HEAVY, _PART * heaviest)
    name = f"{Path(hand).stem}_{1e3 * x:.0f}mm"
    where = str(Path(hand).resolve()) if Path(hand).is_file() else hand
    values = scenario_values(where, size, friction, chosen, best)
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    drawn = hand_figure(built, best.theta, ObjectConfig(**values["plant"]["object"]))
    print_files([file, *save(drawn, folder, name)], folder)
    print(f"next: tactile-hand run {file}")


def _row(number: int, grasp: FoundGrasp) -> list[str]:
    numbers = grasp.load, grasp.grasp_force, grasp.friction, 100.0 * grasp.room
    return [str(number), *(f"{value:.2g}" for value in numbers)]
