# SPDX-License-Identifier: Apache-2.0
"""The same scenario with hand, object, gravity, loads and targets turned in the palm frame.

Physics does not care how a hand is turned; a run must not either. `make study NAME=invariance`
compares the runs.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.plain_yaml import yaml_text
from tactile_hand_ros.control.grasp import VirtualFrame
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.urdf import describe
from tactile_hand_ros.rotations import rotation_from_vector, vector_from_rotation
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant

Array = NDArray[np.float64]

COLUMNS = ("scenario", "turned", "alarms", "largest k_f", "last k_f", "slid", "outcome")
SCENARIOS = ("hold", "pull", "human_hold", "human_pull")

_NEARLY = 5e-4  # rad; with r_z exactly horizontal the frame through the contacts has no upper side


def turned(name: str, rotation: Array, folder: Path, changes: dict[str, Any]) -> Scenario:
    """Return a scenario with all that has a direction turned in the palm frame.

    Args:
        name: Scenario.
        rotation: How everything is turned, shape (3, 3).
        folder: Where the turned hand is written.
        changes: Further changes by dotted key.
    """
    values = dict(changes)
    base = load_scenario(name, values)

    def turn(vector: Any) -> list[float]:
        return [float(x) for x in rotation @ np.asarray(vector, dtype=float)]

    thing, plant = base.plant.object, base.plant
    start = rotation @ rotation_from_vector(thing.rotation)
    # The frame through the contacts has its own rule of which side is up: what is asked for is how
    # far it turns from where it starts.
    points = Plant(plant).state.contacts.positions
    first, first_turned = (VirtualFrame().orientation(p) for p in (points, points @ rotation.T))
    targets = []
    for target in base.targets:
        there: dict[str, Any] = {"time": target.time, "position": "keep"}
        if target.position is not None:
            there["position"] = turn(target.position)
        if target.rotation is not None:
            goal = rotation @ rotation_from_vector(target.rotation) @ first.T
            goal = goal @ rotation.T @ first_turned
            there["rotation"] = vector_from_rotation(goal).tolist()
        targets.append(there)
    pushes = [
        {**push.model_dump(), "force": turn(push.force), "torque": turn(push.torque)}
        for push in plant.disturbances
    ]
    values |= {
        "hand": str(_turned_hand(base, rotation, folder)),
        "layout": "",
        "gravity": turn(base.gravity),
        "targets": targets,
        "plant.object.position": turn(thing.position),
        "plant.object.rotation": vector_from_rotation(start).tolist(),
        "plant.disturbances": pushes,
    }
    return load_scenario(name, values)


def _turned_hand(scenario: Scenario, rotation: Array, folder: Path) -> Path:
    """Write a hand whose joints at the palm are turned about the palm's origin; return its file."""
    euler = optional("scipy.spatial.transform", "A turned hand").Rotation
    hand = load_hand_config(scenario.hand)
    text = describe(hand.folder / hand.urdf, hand.layout(scenario.layout), hand.any_inertia)
    root = ElementTree.fromstring(text)
    for joint in root.iter("joint"):
        parent = joint.find("parent")
        if parent is None or parent.get("link") != hand.palm:
            continue
        origin = joint.find("origin")
        origin = ElementTree.SubElement(joint, "origin") if origin is None else origin
        place, angles = (np.fromstring(origin.get(x, "0 0 0"), sep=" ") for x in ("xyz", "rpy"))
        pose = rotation @ euler.from_euler("xyz", angles).as_matrix()
        origin.set("xyz", " ".join(map(repr, (rotation @ place).tolist())))
        origin.set("rpy", " ".join(map(repr, euler.from_matrix(pose).as_euler("xyz").tolist())))
    (folder / "turned.urdf").write_text(ElementTree.tostring(root, encoding="unicode"), "utf-8")
    data = hand.model_dump(mode="json", exclude={"folder", "layouts", "default_layout"})
    path = folder / "turned.yaml"
    path.write_text(yaml_text({**data, "urdf": "turned.urdf"}), encoding="utf-8")
    return path


def alarms(record: Record) -> int:
    """Return the number of alarms of a run; false ones where nothing slips."""
    slips = record.grip == ContactState.SLIP
    return int((slips[1:] & ~slips[:-1]).sum())


def run_turned(name: str, rotation: Array, changes: dict[str, Any] | None = None) -> Record:
    """Run a turned scenario; see `turned`."""
    with tempfile.TemporaryDirectory() as folder:
        return ClosedLoop(turned(name, rotation, Path(folder), changes or {})).run()


def orientations(count: int, seed: int) -> list[tuple[str, Array]]:
    """Return named rotations: none, the contact normals on palm z, and random ones."""
    random = np.random.default_rng(seed)
    found = [
        ("none", np.eye(3)),
        ("x to z", rotation_from_vector([0.0, _NEARLY - 0.5 * np.pi, 0.0])),
        ("y to z", rotation_from_vector([0.5 * np.pi - _NEARLY, 0.0, 0.0])),
    ]
    for i in range(count):
        q, r = np.linalg.qr(random.standard_normal((3, 3)))
        q *= np.sign(np.diag(r))
        found.append((f"random {i + 1}", q * np.sign(np.linalg.det(q))))
    return found


def compare(name: str, count: int, seed: int) -> list[list[str]]:
    """Run a scenario turned in several ways; return rows of a table, columns as in `COLUMNS`."""
    rows = []
    for label, rotation in orientations(count, seed):
        with tempfile.TemporaryDirectory() as folder:
            scenario = turned(name, rotation, Path(folder), {})
            record = ClosedLoop(scenario).run()
        is_held = bool(np.isfinite(record.true_positions[-1]).all())
        slid = float(np.nanmax(record.true_slid))
        reached = is_held and slid <= scenario.goal.slip_distance
        rows.append(
            [
                name,
                label,
                str(alarms(record)),
                f"{record.grasp_force.max():.2f} N",
                f"{record.grasp_force[-1]:.2f} N",
                f"{1e3 * slid:.3g} mm",
                "held" if reached else "slid" if is_held else "lost",
            ]
        )
    return rows
