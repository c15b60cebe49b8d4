# SPDX-License-Identifier: Apache-2.0
"""Spheres in place of fingertips: one of the tip link, or fitted to the end of its mesh."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import FingerConfig, HandConfig
from tactile_hand_ros.errors import HandModelError, shortened
from tactile_hand_ros.extras import optional

_END = 0.25  # of the extent along the axis, where the fit starts
_ROUNDS = 10  # of fitting and choosing points again
_BEYOND = 1.5  # radii from the center, within which points count
_SAMPLES = 20_000
_WORST = 0.5  # of the radius, error of a fit that is none


class Fit(NamedTuple):
    """A sphere in the frame of a tip link, with the root mean square error of its fit, m."""

    center: Array
    radius: float
    error: float


def fitted_tips(config: HandConfig, description: str) -> tuple[list[FingerConfig], Array]:
    """Return the fingers with spheres in place of tips without a radius, and the errors, (k,), m.

    The spheres are those of the URDF `description`, or fitted to its meshes.

    Raises:
        HandModelError: If a tip has neither radius nor sphere nor mesh, or no sphere fits.
    """
    fingers, errors = list(config.fingers), np.zeros(len(config.fingers))
    root = ElementTree.fromstring(description)
    for i, finger in enumerate(fingers):
        if finger.radius == 0.0:
            axis = np.array(finger.axis)
            fit = _own(root, finger) or fit_tip(_points(root, finger, config.file), axis)
            if not fit.error < _WORST * fit.radius:
                raise HandModelError(
                    f"finger '{finger.name}': no sphere fits the end of the mesh of '{finger.tip}' "
                    f"along the axis {list(finger.axis)}; correct 'axis', or give 'radius' and "
                    "'center' in the hand's YAML"
                )
            update = {"center": tuple(fit.center.tolist()), "radius": fit.radius}
            fingers[i], errors[i] = finger.model_copy(update=update), fit.error
    return fingers, errors


def fit_tip(points: Array, axis: Array) -> Fit:
    """Fit a sphere to points of a surface, shape (n, 3), m, at its end along an axis, shape (3,).

    The points on the far side of the sphere's own middle, along the axis, are chosen again after
    each least-squares fit.
    """
    heights = points @ (axis / np.linalg.norm(axis))
    chosen = heights > heights.max() - _END * np.ptp(heights)
    center, radius, away = np.zeros(3), 0.0, np.zeros(0)
    for _ in range(_ROUNDS):
        if not chosen.any():
            return Fit(np.zeros(3), 0.0, np.inf)
        near = points[chosen]
        # |p|^2 = 2 p.c + (r^2 - |c|^2) is linear in the center c and in the rest.
        system = np.column_stack([2.0 * near, np.ones(len(near))])
        found = np.linalg.lstsq(system, (near**2).sum(axis=1), rcond=None)[0]
        center, radius = found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))
        away = np.linalg.norm(near - center, axis=1) - radius
        apart = points - center
        chosen = (apart @ axis > 0.0) & (np.linalg.norm(apart, axis=1) < _BEYOND * radius)
    return Fit(center, radius, float(np.sqrt((away**2).mean())))


def _own(root: Element, finger: FingerConfig) -> Fit | None:
    """Return the sphere of a tip link's collision shapes, the last one along its axis."""
    found = []
    for shape in root.findall(f"link[@name='{finger.tip}']/collision"):
        if (sphere := shape.find("geometry/sphere")) is not None:
            center = three_numbers(shape.find("origin"), "xyz")
            found.append(Fit(center, float(_numbers(sphere.get("radius", ""), 1)[0]), 0.0))
    return max(found, key=lambda fit: float(fit.center @ np.array(finger.axis)), default=None)


def _points(root: Element, finger: FingerConfig, file: Path) -> Array:
    """Return points on the mesh of a tip link in its frame, shape (n, 3), m."""
    link = f"link[@name='{finger.tip}']"
    for shape in (*root.findall(f"{link}/visual"), *root.findall(f"{link}/collision")):
        mesh, origin = shape.find("geometry/mesh"), shape.find("origin")
        if mesh is None:
            continue
        points = _sampled(_mesh_file(str(mesh.get("filename")), file))
        turn = pin.rpy.rpyToMatrix(three_numbers(origin, "rpy"))
        place = three_numbers(origin, "xyz")
        return np.asarray(points * three_numbers(mesh, "scale", "1 1 1") @ turn.T + place)
    raise HandModelError(
        f"finger '{finger.name}' has no radius, and its tip link '{finger.tip}' has neither a "
        "sphere nor a mesh to fit one to; give 'radius' and 'center' in the hand's YAML"
    )


def _sampled(mesh: Path) -> Array:
    """Return points on the surface of a mesh, shape (n, 3); HandModelError if it is damaged."""
    trimesh = optional("trimesh", "Fitting a fingertip")
    try:
        body = trimesh.load(mesh, force="mesh")
        return np.asarray(trimesh.sample.sample_surface(body, _SAMPLES, seed=0)[0])
    except Exception as error:  # damaged data can fail anywhere in the parsers
        raise HandModelError(
            f"the mesh '{mesh}' cannot be used: {shortened(error)}; correct the file, or give "
            "'radius' and 'center' of the fingertip in the hand's YAML"
        ) from None


def three_numbers(element: Element | None, key: str, default: str = "0 0 0") -> Array:
    """Return an attribute with three numbers, shape (3,); HandModelError if it has others."""
    return _numbers(default if element is None else element.get(key, default), 3)


def _numbers(text: str, count: int) -> Array:
    """Return the numbers of a text, shape (count,); HandModelError if it has others."""
    try:
        found = np.array(text.split(), dtype=float)
    except ValueError:
        found = np.zeros(0)
    if len(found) != count or not np.isfinite(found).all():
        expected = "a number" if count == 1 else "three numbers"
        raise HandModelError(f"the URDF has '{text}', expected {expected}")
    return found


def _mesh_file(name: str, file: Path) -> Path:
    """Return the mesh that a URDF names, by ``package://`` or relative to the URDF's file."""
    inside = name.split("://", 1)[-1]
    for folder in file.resolve().parents:
        for candidate in (folder / inside, folder / inside.split("/", 1)[-1]):
            if candidate.is_file():
                return candidate
    raise HandModelError(
        f"the mesh '{name}' is not beside '{file}'; correct the URDF, or give 'radius' and "
        "'center' of the fingertip in the hand's YAML"
    )
