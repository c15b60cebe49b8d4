# SPDX-License-Identifier: Apache-2.0
"""The same scenario on a hand that is rotated, smaller, lighter, or lists its fingers differently.

Physics does not depend on the orientation of a hand or the order of its fingers, so a run must not
either. Size, rates of ticks and skin, and encoder bits may change numbers, but no outcome.
`make study NAME=invariance` compares the runs.
"""

from __future__ import annotations

import functools
import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.plain_yaml import yaml_text
from tactile_hand_ros.control.grasp import VirtualFrame
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.urdf import describe
from tactile_hand_ros.rotations import rotation_from_vector, vector_from_rotation
from tactile_hand_ros.run.events import alarm_count
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant

COLUMNS = ("scenario", "changed", "alarms", "largest k_f", "last k_f", "slid", "outcome")
SCENARIOS = ("hold", "pull", "human_hold", "human_pull")

RATES = ((100, 100), (200, 200), (500, 100), (1000, 2000), (2000, 1000))
"""Rates of ticks and skin [Hz]; at 125 Hz, fingers as light as the human hand's are unstable."""
BITS = (12, 14, 20)
LINKS, MASSES = (0.01, 0.05, 0.25), (0.005, 0.05, 0.3, 1.0)

_NEARLY = 5e-4  # rad; with r_z exactly horizontal the frame of the contacts is ambiguous


def turned(name: str, rotation: Array, folder: Path, changes: dict[str, Any]) -> Scenario:
    """Return a scenario with all directions rotated in the palm frame; write its hand."""
    base = load_scenario(name, changes)

    def turn(vector: Any) -> Any:
        return (rotation @ np.asarray(vector)).tolist()

    thing, plant = base.plant.object, base.plant
    start = rotation @ rotation_from_vector(thing.rotation)
    points = Plant(plant).state.contacts.positions
    pushes = [
        {**push.model_dump(), "force": turn(push.force), "torque": turn(push.torque)}
        for push in plant.disturbances
    ]
    values = {
        "hand": str(_changed_hand(base, folder, rotation=rotation)),
        "layout": "",
        "gravity": turn(base.gravity),
        "targets": _targets(base, rotation, points, points @ rotation.T),
        "plant.object.position": turn(thing.position),
        "plant.object.rotation": vector_from_rotation(start).tolist(),
        "plant.disturbances": pushes,
    }
    return load_scenario(name, changes | values)


def reordered(name: str, order: Sequence[int], folder: Path, changes: dict[str, Any]) -> Scenario:
    """Return a scenario whose hand lists its fingers in another order; the joint order stays."""
    base = load_scenario(name, changes)
    points = Plant(base.plant).state.contacts.positions
    values = {
        "hand": str(_changed_hand(base, folder, order=order)),
        "layout": "",
        "targets": _targets(base, np.eye(3), points, points[list(order)]),
    }
    return load_scenario(name, changes | values)


def _targets(base: Scenario, rotation: Array, points: Array, others: Array) -> list[dict[str, Any]]:
    """Return rotated targets for a hand with other contacts or another order of contacts.

    The virtual frame depends on the order of the contacts. So the targets are expressed relative to
    the initial frame.
    """
    first, other = (VirtualFrame().orientation(p) for p in (points, others))
    targets = []
    for target in base.targets:
        there: dict[str, Any] = {"time": target.time, "position": "keep"}
        if target.position is not None:
            there["position"] = (rotation @ np.asarray(target.position)).tolist()
        if target.rotation is not None:
            goal = rotation @ rotation_from_vector(target.rotation) @ first.T
            there["rotation"] = vector_from_rotation(goal @ rotation.T @ other).tolist()
        targets.append(there)
    return targets


def resized(
    name: str, scale: float, link: float, mass: float, folder: Path, changes: dict[str, Any]
) -> Scenario:
    """Return a scenario in another size, with a cube and matching gains.

    `scale` is relative to the scenario's hand; `link` and `mass` are the masses of each link and of
    the object [kg].
    """
    base = load_scenario(name)
    thing, law = base.plant.object, "manipulation_controller.law."
    values = {
        "hand": str(_changed_hand(base, folder, scale=scale, link=link)),
        "layout": "",
        "targets": [],
        "plant.object.size": [scale * edge for edge in thing.size],
        "plant.object.position": [scale * x for x in thing.position],
        "plant.object.mass": mass,
        "tactile_sensor.location_noise": scale * base.tactile_sensor.location_noise,
        "slip_regulator.grasp_force": 1.0 + 4.0 * mass * float(np.linalg.norm(base.gravity)),
        **dict.fromkeys([f"{law}k_p", f"{law}k_o", f"{law}damping"], 0.0),
        **dict.fromkeys([f"{law}integral.k_p", f"{law}integral.k_o"], 0.0),
    }
    return load_scenario(name, values | changes)


def _changed_hand(
    scenario: Scenario,
    folder: Path,
    *,
    rotation: Array | None = None,
    scale: float = 1.0,
    link: float | None = None,
    order: Sequence[int] | None = None,
) -> Path:
    """Write a modified copy of a scenario's hand, and return its file.

    Defaults leave the hand unchanged. It can be rotated about the palm's origin, scaled in all
    lengths, given another mass of each link [kg], or another order of fingers.
    """
    hand = load_hand_config(scenario.hand)
    text, _ = describe(hand, scenario.layout)
    root = ElementTree.fromstring(text)
    for origin in root.iter("origin"):
        place = scale * np.fromstring(origin.get("xyz", "0 0 0"), sep=" ")
        origin.set("xyz", _numbers(place))
    for body in root.iter("inertial"):
        inertia, found = (next(body.iter(tag)) for tag in ("inertia", "mass"))
        before = float(found.get("value", "nan"))
        mass = before if link is None else float(link)
        found.set("value", repr(mass))
        for key, value in inertia.attrib.items():
            inertia.set(key, repr(scale**2 * mass / before * float(value)))
    if rotation is not None:
        _turn_mounts(root, hand.palm, rotation)
    (folder / "changed.urdf").write_text(ElementTree.tostring(root, encoding="unicode"), "utf-8")
    data = hand.model_dump(mode="json", exclude={"folder", "layouts", "default_layout"})
    fingers = [{**finger, "radius": scale * finger["radius"]} for finger in data["fingers"]]
    fingers = fingers if order is None else [fingers[i] for i in order]
    path = folder / "changed.yaml"
    changed = {**data, "urdf": "changed.urdf", "fingers": fingers}
    path.write_text(yaml_text(changed), encoding="utf-8")
    return path


def _turn_mounts(root: ElementTree.Element, palm: str, rotation: Array) -> None:
    """Rotate the joints at the palm about its origin."""
    euler = optional("scipy.spatial.transform", "A rotated hand").Rotation
    for joint in root.iter("joint"):
        parent = joint.find("parent")
        if parent is None or parent.get("link") != palm:
            continue
        origin = joint.find("origin")
        origin = ElementTree.SubElement(joint, "origin") if origin is None else origin
        place, angles = (np.fromstring(origin.get(x, "0 0 0"), sep=" ") for x in ("xyz", "rpy"))
        pose = rotation @ euler.from_euler("xyz", angles).as_matrix()
        origin.set("xyz", _numbers(rotation @ place))
        origin.set("rpy", _numbers(euler.from_matrix(pose).as_euler("xyz")))


def _numbers(vector: Array) -> str:
    """Return a vector in URDF notation."""
    return " ".join(map(repr, vector.tolist()))


def orientations(count: int, seed: int) -> list[tuple[str, Array]]:
    """Return named rotations: none, contact normals to palm z, and random ones."""
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


def ways(name: str, count: int, seed: int) -> list[tuple[str, functools.partial[Scenario]]]:
    """Return the variants of a scenario: a label, and a function that creates it in a `folder`."""
    make = functools.partial
    turns = orientations(count, seed)
    found = [(label, make(turned, name, rotation, changes={})) for label, rotation in turns]
    for order in ((1, 2, 0), (2, 1, 0)):
        label = "fingers " + ", ".join(str(i + 1) for i in order)
        found.append((label, make(reordered, name, order, changes={})))
    for rate, skin in RATES:
        changes = {"plant.rate": rate, "tactile_sensor.rate": skin, "plant.time_step": 0.0005}
        found.append((f"ticks {rate:g} Hz, skin {skin:g} Hz", make(_changed, name, changes)))
    for bits in BITS:
        found.append((f"{bits} bits", make(_changed, name, {"plant.encoder.bits": bits})))
    for link, mass in itertools.product(LINKS, MASSES) if name == "hold" else ():
        label = f"a quarter of the size, links {1e3 * link:g} g, object {1e3 * mass:g} g"
        found.append((label, make(resized, name, 0.25, link, mass, changes={"duration": 6.0})))
    return found


def _changed(name: str, changes: dict[str, Any], folder: Path) -> Scenario:
    return load_scenario(name, changes)


def compare(name: str, count: int, seed: int) -> list[list[str]]:
    """Run all variants of a scenario; return table rows with the columns of `COLUMNS`."""
    rows = []
    for label, make in ways(name, count, seed):
        with tempfile.TemporaryDirectory() as folder:
            scenario = make(folder=Path(folder))
            record = ClosedLoop(scenario).run()
        is_held = bool(np.isfinite(record.true_positions[-1]).all())
        slid = float(np.nanmax(record.true_slid))
        reached = is_held and slid <= scenario.goal.slip_distance
        rows.append(
            [
                name,
                label,
                str(alarm_count(record)),
                f"{record.grasp_force.max():.2f} N",
                f"{record.grasp_force[-1]:.2f} N",
                f"{1e3 * slid:.3g} mm",
                "held" if reached else "slid" if is_held else "lost",
            ]
        )
    return rows
