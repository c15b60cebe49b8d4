# SPDX-License-Identifier: Apache-2.0
"""Hands that exist with three shapes: what each holds, moves, turns, and keeps under a pull.

Every pair starts as a user would: a search for a grasp, and the scenario that it writes. No gain is
set. What a hand cannot do comes with the reason that its users would read.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tactile_hand_ros.control.grasp import VirtualFrame
from tactile_hand_ros.errors import PoseError, TactileHandError
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector, vector_from_rotation
from tactile_hand_ros.scenario.grasp_search import FoundGrasp, scenario_values, search
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant_config import ObjectConfig

HANDS = ("allegro", "dex3", "shadow", "ability", "panda")
SHAPES = {
    "box": (0.05, 0.05, 0.05),
    "cylinder": (0.05, 0.05, 0.08),
    "sphere": (0.05, 0.05, 0.05),
}
PAIRS = tuple(itertools.product(HANDS, SHAPES))
COLUMNS = (
    "hand",
    "shape",
    "mass, g",
    "directions",
    "hold",
    "move 5 mm",
    "turn 0.1 rad",
    "pull 2 N",
)

FRICTION = 0.8  # of rubber on plastic
_GRAVITY = 9.81  # m/s^2
_PULL = 2.0  # N
_MOVE, _TURN = 0.005, 0.1  # m and rad
_LIGHT, _HEAVY = 0.02, 0.2  # kg
_NEAR = 1e-3, 0.03  # m and rad, errors of a pose that counts as reached
_SLIPPED = 1e-3  # m, that a table need not mention
_AXES = (*np.eye(3), *-np.eye(3))
_SECONDS = 4.0


def tried(pair: tuple[str, str]) -> list[str]:
    """Return a row of `COLUMNS` for a hand and a shape."""
    name, shape = pair
    try:
        body, found = _grasped(name, shape)
    except TactileHandError as error:
        return [name, shape, "", "", *[str(error)] * 4]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.yaml"
        values = scenario_values(name, body, found) | {"duration": _SECONDS}
        file.write_text(yaml.safe_dump(values))
        pulled = {"kind": "step", "start": 1.0, "force": [0.0, 0.0, -_PULL]}
        results = (
            _result(file, {})[0],
            _moved(file, _moves(found)),
            _moved(file, _turns(found)),
            _result(file, {"plant.disturbances": [pulled]})[0],
        )
    return [name, shape, f"{1e3 * body.mass:.0f}", str(found.motions), *results]


def _grasped(name: str, shape: str) -> tuple[ObjectConfig, FoundGrasp]:
    """Return an object whose weight leaves room for the pull, and the best grasp of it."""
    hand = Hand.load(name, gravity=np.array([0.0, 0.0, -_GRAVITY]))
    looks = {"shape": shape, "size": list(SHAPES[shape]), "friction": FRICTION}
    body = ObjectConfig().changed(looks)
    best = search(hand, body)[0]
    mass = min(_HEAVY, max(_LIGHT, 0.5 * (best.load - _PULL) / _GRAVITY))
    return body.changed({"mass": mass}), best


def _moves(found: FoundGrasp) -> Iterator[dict[str, Any]]:
    """Yield targets at a distance along each palm axis, both ways."""
    for axis in _AXES:
        yield {"position": (found.contacts.centroid + _MOVE * axis).tolist()}


def _turns(found: FoundGrasp) -> Iterator[dict[str, Any]]:
    """Yield targets turned about each palm axis, both ways."""
    frame = VirtualFrame().orientation(found.contacts.positions)
    for axis in _AXES:
        turned = rotation_from_vector(_TURN * axis) @ frame
        yield {"position": "keep", "rotation": vector_from_rotation(turned).tolist()}


def _moved(file: Path, targets: Iterator[dict[str, Any]]) -> str:
    """Return the result of the first target that is reached, or why there is none."""
    reason = missed = ""
    for target in targets:
        changes = {"targets": [{"time": 1.0, **target}]}
        try:
            check_scenario(load_scenario(str(file), changes))
        except PoseError as error:
            reason = reason or str(error).split("out of reach: ")[-1].split("; ask")[0]
            continue
        text, reached = _result(file, changes)
        if reached:
            return text
        missed = missed or f"not reached: {text}"
    return missed or reason


def _result(file: Path, changes: dict[str, Any]) -> tuple[str, bool]:
    """Return the final errors of a run as text, and whether they are small."""
    metrics = simulate(str(file), changes).metrics
    position, rotation = metrics.final_position_error_m, metrics.final_rotation_error_rad
    errors = f"{1e3 * position:.2f} mm, {1e3 * rotation:.0f} mrad"
    if not math.isnan(metrics.dropped_at_s):
        return f"dropped at {metrics.dropped_at_s:.1f} s", False
    slid = metrics.max_slip_distance_m
    text = errors if slid <= _SLIPPED else f"{errors}, slid {1e3 * slid:.1f} mm"
    return text, position < _NEAR[0] and rotation < _NEAR[1]
