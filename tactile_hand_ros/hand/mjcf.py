# SPDX-License-Identifier: Apache-2.0
"""An MJCF file as a URDF, read by MuJoCo, so that hands of both formats are built in one way."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.rotations import rotation_from_quaternion

_FREE, _SLIDE, _HINGE = 0, 2, 3  # of mjtJoint
_SPHERE, _CAPSULE, _CYLINDER, _BOX = 2, 3, 5, 6  # of mjtGeom
_ENDLESS = 1e3  # N m or N, effort of a joint without an actuator that has a limit
_FASTEST = 1e2  # rad/s or m/s; MJCF has no limits of speed


def urdf_of_mjcf(path: Path) -> Element:
    """Return the links and joints of an MJCF file as a URDF.

    Bodies become links. A body with several joints gets a link without mass between two of them.
    Efforts are those of the actuators. Shapes that collide are kept, except meshes and ellipsoids.
    Rotor inertia and tendons are left out.

    Raises:
        HandModelError: If MuJoCo cannot read it, or a joint is a ball.
    """
    mujoco = optional("mujoco", "Reading an MJCF file", package="mujoco-core")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise HandModelError(f"MuJoCo cannot read '{path}': {error}; correct the file") from None
    root = Element("robot", name=path.stem)
    efforts = _efforts(model)
    for body in range(model.nbody):
        _add_shapes(_add_link(root, model, body), model, body)
        if body:
            _add_joints(root, model, body, efforts)
    return root


def _efforts(model: Any) -> Array:
    """Return the largest torque or force of each joint, from its actuators and its own limit."""
    out = np.zeros(model.njnt)
    for i in np.flatnonzero(model.actuator_trntype == 0).tolist():
        joint = model.actuator_trnid[i, 0]
        out[joint] += abs(model.actuator_gear[i, 0]) * _largest_force(model, i, joint)
    out = np.where(out > 0.0, out, _ENDLESS)
    own = np.where(model.jnt_actfrclimited, np.abs(model.jnt_actfrcrange).max(axis=1), _ENDLESS)
    return np.minimum(out, own)


def _largest_force(model: Any, actuator: int, joint: int) -> float:
    """Return the largest force of an actuator, else that of its control and joint; 0 if endless."""
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    if not model.actuator_ctrllimited[actuator]:
        return 0.0
    controls = model.actuator_gainprm[actuator, 0] * model.actuator_ctrlrange[actuator]
    constant, stiffness = model.actuator_biasprm[actuator, :2]
    lengths = model.actuator_gear[actuator, 0] * model.jnt_range[joint]
    return float(np.abs(controls[:, None] + constant + stiffness * lengths).max())


def _add_link(root: Element, model: Any, body: int) -> Element:
    link = SubElement(root, "link", name=model.body(body).name)
    if model.body_mass[body] <= 0.0:
        return link
    inertial = SubElement(link, "inertial")
    _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
    SubElement(inertial, "mass", value=repr(float(model.body_mass[body])))
    moments = zip(("ixx", "iyy", "izz"), model.body_inertia[body].tolist(), strict=True)
    values = {key: repr(value) for key, value in moments}
    SubElement(inertial, "inertia", values, ixy="0", ixz="0", iyz="0")
    return link


def _add_shapes(link: Element, model: Any, body: int) -> None:
    """Give a link the shapes of its body that collide; a capsule is a cylinder and two spheres."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    for geom in np.flatnonzero((model.geom_bodyid == body) & collides):
        kind, place, turn = model.geom_type[geom], model.geom_pos[geom], model.geom_quat[geom]
        radius, half, _ = sizes = model.geom_size[geom]
        rod = {"radius": radius, "length": 2.0 * half}
        end = _matrix(turn) @ np.array([0.0, 0.0, half])
        shapes = {
            _SPHERE: [("sphere", {"radius": radius}, place)],
            _CAPSULE: [
                ("cylinder", rod, place),
                *(("sphere", {"radius": radius}, place + each) for each in (end, -end)),
            ],
            _CYLINDER: [("cylinder", rod, place)],
            _BOX: [("box", {"size": 2.0 * sizes}, place)],
        }.get(kind, [])
        for tag, size, center in shapes:
            collision = SubElement(link, "collision")
            _add_origin(collision, center, turn)
            numbers = {key: _text(value) for key, value in size.items()}
            SubElement(SubElement(collision, "geometry"), tag, numbers)


def _add_joints(root: Element, model: Any, body: int, efforts: Array) -> None:
    """Connect a body to its parent by its joints in their order."""
    name, parent = model.body(body).name, model.body(model.body_parentid[body]).name
    place, turn, before = model.body_pos[body], model.body_quat[body], np.zeros(3)
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    if count == 0:
        _add_joint(root, f"{name}_mount", "fixed", parent, name, place, turn)
    for joint in range(first, first + count):
        label, kind = model.joint(joint).name, model.jnt_type[joint]
        if kind == _FREE:  # an object beside the hand, or the whole hand: cut off at the palm
            _add_joint(root, label or f"{name}_free", "floating", parent, name, place, turn)
            return
        if kind not in (_HINGE, _SLIDE):
            raise HandModelError(
                f"joint '{label}' of the MJCF is a ball; expected hinges and slides: replace it by "
                "three hinges"
            )
        is_last, at = joint == first + count - 1, model.jnt_pos[joint]
        # The link between two joints has its origin on the axis of the first.
        child = name if is_last and not at.any() else f"{label}_link"
        limited = "revolute" if model.jnt_limited[joint] else "continuous"
        own, there = "prismatic" if kind == _SLIDE else limited, _matrix(turn) @ (at - before)
        element = _add_joint(root, label, own, parent, child, place + there, turn)
        if child != name:
            SubElement(root, "link", name=child)
        SubElement(element, "axis", xyz=_text(model.jnt_axis[joint]))
        lower, upper = model.jnt_range[joint].tolist()
        limits = {"lower": lower, "upper": upper, "effort": efforts[joint], "velocity": _FASTEST}
        SubElement(element, "limit", {key: repr(float(value)) for key, value in limits.items()})
        dof = model.jnt_dofadr[joint]
        losses = model.dof_damping[dof], model.dof_frictionloss[dof]
        SubElement(element, "dynamics", damping=_text(losses[0]), friction=_text(losses[1]))
        parent, place, turn, before = child, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), at
    if count and parent != name:
        _add_joint(root, f"{name}_mount", "fixed", parent, name, -before, turn)


def _add_joint(
    root: Element, name: str, kind: str, parent: str, child: str, place: Array, turn: Array
) -> Element:
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _add_origin(joint, place, turn)
    return joint


def _add_origin(element: Element, place: Array, turn: Array) -> None:
    angles = pin.rpy.matrixToRpy(_matrix(turn))
    SubElement(element, "origin", xyz=_text(place), rpy=_text(angles))


def _matrix(turn: Array) -> Array:
    """Return the rotation of a quaternion (w, x, y, z) of MuJoCo."""
    return rotation_from_quaternion(np.roll(turn, -1))


def _text(values: Any) -> str:
    return " ".join(map(repr, np.atleast_1d(values).tolist()))
