# SPDX-License-Identifier: Apache-2.0
"""Hands of any size as URDF and YAML, and objects that fit them."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from tactile_hand_ros.control.reach import inverse_kinematics
from tactile_hand_ros.hand.hand import Hand

Array = NDArray[np.float64]

_BENT = (1.0, 0.0, 1.2, 0.6, 0.1, 0.1)  # angles of a finger's joints that bend it inwards, rad
LINK = 0.3  # half the total length of a finger's links, m


def kinetic_energy(hand: Hand, theta: Array, rates: Array) -> float:
    """Return the kinetic energy of the links, J."""
    moved = hand.all_angles(rates) - hand.all_angles(0.0 * rates)
    data = hand.model.createData()
    return float(pin.computeKineticEnergy(hand.model, data, hand.all_angles(theta), moved))


def potential_energy(hand: Hand, theta: Array) -> float:
    """Return the potential energy of the links, J."""
    data = hand.model.createData()
    return float(pin.computePotentialEnergy(hand.model, data, hand.all_angles(theta)))


def _link(name: str, length: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="0.2"/>'
        '<inertia ixx="0.001" iyy="0.002" izz="0.0025" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, rest: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"<origin {xyz}/>{rest}</joint>"
    )


def _finger(name: str, joints: int, bearing: float) -> str:
    """Write a finger that stands at `bearing` on a circle and bends about changing axes."""
    place = f'xyz="{LINK * math.cos(bearing)} {LINK * math.sin(bearing)} 0" rpy="0 0 {bearing}"'
    parts = [
        f'<link name="{name}_base"/>',
        _joint(f"{name}_mount", "fixed", "palm", f"{name}_base", place),
    ]
    parent, origin = f"{name}_base", 'xyz="0 0 0"'
    axes: tuple[str, ...] = ("0 -1 0", "0 0 1", "0 -1 0", "0 -1 0", "1 0 0", "0 -1 0")
    # The first two joints share a place; the others divide the finger's length.
    lengths = [0.0] + [2.0 * LINK / max(1, joints - 1)] * (joints - 1)
    if joints == 2:  # bends in its plane only
        axes, lengths = ("0 -1 0", "0 -1 0"), [LINK, LINK]
    for j in range(joints):
        child = f"{name}_link_{j + 1}"
        rest = f'<axis xyz="{axes[j]}"/><limit lower="-3" upper="3" effort="30" velocity="20"/>'
        parts += [
            _joint(f"{name}_joint_{j + 1}", "revolute", parent, child, origin, rest),
            _link(child, lengths[j] or 0.05),
        ]
        parent, origin = child, f'xyz="{lengths[j]} 0 0"'
    parts += [
        f'<link name="{name}_tip"/>',
        _joint(f"{name}_tip_mount", "fixed", parent, f"{name}_tip", origin),
    ]
    return "".join(parts)


def write_hand(folder: Path, joints: Sequence[int], **more: Any) -> Path:
    """Write a hand whose fingers have 2 to 6 joints each, with further keys, as a YAML file."""
    k = len(joints)
    names = [f"f{i + 1}" for i in range(k)]
    bearings = [2.0 * math.pi * i / k for i in range(k)]
    fingers = [_finger(*f) for f in zip(names, joints, bearings, strict=True)]
    urdf = f'<robot name="bench"><link name="palm"/>{"".join(fingers)}</robot>'
    (folder / "hand.urdf").write_text(urdf)
    config = {
        "urdf": "hand.urdf",
        "fingers": [{"name": n, "tip": f"{n}_tip", "radius": 0.02} for n in names],
        **more,
    }
    path = folder / "hand.yaml"
    path.write_text(yaml.safe_dump(config))
    return path


def changed(path: Path, *replaced: tuple[str, str], **more: Any) -> Hand:
    """Replace texts, each once, in the URDF of `write_hand`, and add keys to its YAML file."""
    urdf = path.parent / "hand.urdf"
    text = urdf.read_text()
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new, 1)
    urdf.write_text(text)
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **more}))
    return Hand.load(str(path))


def posture_for(hand: Hand, tips: Array) -> Array:
    """Return joint angles that bring the tips of a `write_hand` hand to `tips`, shape (k, 3), m."""
    counts = Counter(name.split("_")[0] for name in hand.joint_names)
    bent = [
        (_BENT[0], _BENT[2]) if counts[finger] == 2 else _BENT[: counts[finger]]
        for finger in hand.finger_names
    ]
    start = np.concatenate(bent)
    theta, missing = inverse_kinematics(hand, tips, start)
    assert missing.max() < 1e-4, f"the fingertips stay {missing} m short of their places"
    return theta


def prism_grasp(folder: Path, joints: Sequence[int], **more: Any) -> dict[str, Any]:
    """Return a scenario whose fingers, of `write_hand`, touch one side each of an upright prism."""
    path, k, apothem, height = write_hand(folder, joints, **more), len(joints), 0.1, 0.4
    bearings = 2.0 * np.pi * np.arange(k) / k
    outward = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(k)], axis=1)
    tips = (apothem + 0.02) * outward + [0.0, 0.0, height]
    # Corners lie between the fingers.
    between = bearings + np.pi / k
    ring = apothem / np.cos(np.pi / k) * np.stack([np.cos(between), np.sin(between)], axis=1)
    corners = [[x, y, z] for x, y in ring for z in (-0.12, 0.12)]
    return {
        "hand": str(path),
        "layout": "",
        "plant.initial_joints": posture_for(Hand.load(str(path)), tips).tolist(),
        "plant.object.vertices": np.ravel(corners).tolist(),
        "plant.object.position": [0.0, 0.0, height],
    }


def tip_rotations(description: str, tips: Sequence[str], theta: NDArray) -> NDArray:
    """Return the orientations of tip links by Pinocchio alone, shape (k, 3, 3)."""
    model = pin.buildModelFromXML(description)
    data = model.createData()
    pin.framesForwardKinematics(model, data, theta)
    return np.array([data.oMf[model.getFrameId(tip)].rotation for tip in tips])
