# SPDX-License-Identifier: Apache-2.0
"""Random hands of human size: does each keep an object when commands stop, and under a pull?

Fingers, joints, encoders, ticks, gravity, object and pull are random. Each hand starts as a user
would: a search for a grasp, and the scenario that it writes.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.config.plain_yaml import yaml_text
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.grasp_search import scenario_values, search
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant_config import ObjectConfig

COLUMNS = ("seed", "joints", "object", "ticks, encoders", "start", "stopped 1 s", "pull")

_GRAVITY = 9.81  # m/s^2
_PULL = 3.5  # s, when it begins
_LOADS = 0.1, 0.4  # of the largest load of the grasp: weight, and pull


def tried(seed: int) -> list[str]:
    """Return a row of `COLUMNS` for a random hand, or why it grasps nothing."""
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        joints = _write_hand(Path(folder), random)
        row = [str(seed), " ".join(map(str, joints))]
        try:
            scenario = _scenario(Path(folder), random)
        except GraspError:
            return [*row, "no grasp found", *[""] * 4]
        thing, plant = scenario.plant.object, scenario.plant
        row.append(f"{thing.shape}, {1e3 * thing.size[0]:.0f} mm, {1e3 * thing.mass:.0f} g")
        row.append(f"{plant.rate:g} Hz, {plant.encoder.bits} bits")
        guarded = GuardedLoop(scenario)
        row += [_effect(guarded, 1.5), _effect(guarded, 1.0, answers=False), _effect(guarded, 2.0)]
    return row


def _effect(guarded: GuardedLoop, seconds: float, *, answers: bool = True) -> str:
    """Run on, and return how far the object moves and slides meanwhile."""
    watch = Watch(guarded)
    watch.run(seconds, answers=answers)
    return "lost" if watch.is_lost else f"{1e3 * watch.moved:.1f}, slid {1e3 * watch.slid:.1f} mm"


def _write_hand(folder: Path, random: np.random.Generator) -> list[int]:
    """Write a thumb against two to four fingers side by side; return their numbers of joints."""
    joints: list[int] = random.integers(3, 5, random.integers(3, 6)).tolist()
    scale, effort = random.uniform(0.7, 1.6), random.uniform(0.3, 2.0)
    masses = random.uniform(0.01, 0.08) * np.linspace(1.0, 0.4, 4)
    away, radius = scale * random.uniform(0.035, 0.055), random.uniform(0.006, 0.014)
    parts, tips = ['<link name="palm"/>'], []
    for finger, count in enumerate(joints):
        x, y = (away, 0.024 * scale * (finger - 0.5 * len(joints))) if finger else (-away, 0.0)
        origin = f'xyz="{x} {y} 0" rpy="0 {-0.5 * math.pi} {0.0 if finger else math.pi}"'
        # The first joint spreads the finger, or turns it about its length; the others bend it.
        first = "1 0 0" if finger and random.random() < 0.3 else "0 0 1"
        parent, length = "palm", 0.0
        for j in range(count):
            length = scale * random.uniform(0.022, 0.05) if j else 0.0
            low, high, axis = (-0.3, 1.8, "0 -1 0") if j else (-0.6, 0.6, first)
            swing = masses[j] * (max(length, 0.015) ** 2 / 12.0 + 2e-5)
            name = f"f{finger}_{j}"
            parts.append(
                f'<joint name="{name}" type="revolute"><parent link="{parent}"/><origin {origin}/>'
                f'<child link="{name}_link"/><axis xyz="{axis}"/>'
                f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="12"/></joint>'
                f'<link name="{name}_link"><inertial><origin xyz="{0.5 * length} 0 0"/>'
                f'<mass value="{masses[j]}"/><inertia ixx="{0.2 * swing}" iyy="{swing}" '
                f'izz="{swing}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            )
            parent, origin = f"{name}_link", f'xyz="{length} 0 0"'
        shape = {"radius": radius, "center": [length, 0.0, 0.0], "axis": [1.0, 0.0, 1.0]}
        tips.append({"name": f"f{finger}", "tip": parent, **shape})
    (folder / "hand.urdf").write_text(f'<robot name="random">{"".join(parts)}</robot>')
    (folder / "hand.yaml").write_text(yaml_text({"urdf": "hand.urdf", "fingers": tips}))
    return joints


def _scenario(folder: Path, random: np.random.Generator) -> Scenario:
    """Return a scenario in which the hand holds a random object that is pulled."""
    hand, down = str(folder / "hand.yaml"), random.standard_normal(3)
    gravity = _GRAVITY / np.linalg.norm(down) * down
    size = [random.uniform(0.03, 0.06)] * 3
    looks = {"shape": str(random.choice(["box", "cylinder", "sphere"])), "size": size}
    body = ObjectConfig().changed({**looks, "friction": random.uniform(0.4, 0.9)})
    found = search(Hand.load(hand, gravity=gravity), body)[0]
    weight, pull = (random.uniform(*_LOADS) * found.load for _ in range(2))
    body = body.changed({"mass": min(0.3, weight / _GRAVITY)})
    way = random.standard_normal(3)
    force = (pull / np.linalg.norm(way) * way).tolist()
    (folder / "scenario.yaml").write_text(yaml_text(scenario_values(hand, body, found)))
    changes = {
        "gravity": gravity.tolist(),
        "plant.rate": float(random.choice([500.0, 1000.0])),
        "plant.encoder.bits": int(random.choice([12, 14, 16])),
        "plant.disturbances": [{"kind": "step", "start": _PULL, "force": force}],
    }
    return load_scenario(str(folder / "scenario.yaml"), changes)
