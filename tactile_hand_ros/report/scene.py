# SPDX-License-Identifier: Apache-2.0
"""Hand and object in space: the paper's Fig. 2, and a hand alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.style import (
    AXES,
    FAINT,
    INK,
    PAGE,
    finger_color,
    look,
    new_figure,
)
from tactile_hand_ros.rotations import rodrigues, rotation_from_quaternion
from tactile_hand_ros.run.derived import contact_forces, dropped_at
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.plant_config import ObjectConfig
from tactile_hand_ros.simulation.solid import Solid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Lengths as fractions of the hand's reach.
_ARROW = 0.2  # strongest force
_CONTACT_AXIS, _PALM_AXIS = 0.1, 0.22
_WHEN = ("start", "end")
_CAPTION = "arrows at contacts: force on the object, {:.2g} mm per N     black line: path of the "
_CAPTION += "contact centroid to its target"


def grasp_figure(record: Record, scenario: Scenario) -> Figure:
    """Draw hand, object, contacts and forces at the first tick with forces and at the last.

    The object is omitted without ground truth, and after it has fallen away.
    """
    hand = Hand.load(scenario.hand, scenario.layout)
    rows, dropped = (min(1, len(record) - 1), len(record) - 1), dropped_at(record)
    points = np.vstack([point for row in rows for point in hand.joint_positions(record.theta[row])])
    reach = float(np.linalg.norm(points, axis=1).max())
    forces = known_part(contact_forces(record)[list(rows)])
    strongest = np.nanmax(np.linalg.norm(forces, axis=2), initial=1e-9)
    per_newton = _ARROW * reach / float(strongest)
    with look():
        figure = new_figure(PAGE, 3.1, layout="none")
        for number, row in enumerate(rows):
            axes = _panel(figure, points, 0.5 * number, 0.5)
            title = f"({'ab'[number]}) {_WHEN[number]}"
            _draw_hand(axes, hand.joint_positions(record.theta[row]), hand.radii, reach)
            _draw_object(axes, record, row, scenario, reach)
            _draw_contacts(axes, record, row, reach, per_newton)
            title += f", $t$ = {record.times[row]:.3g} s"
            if number and not math.isnan(dropped):
                title += f": object dropped at {dropped:.3g} s"
            figure.text(0.015 + 0.5 * number, 0.985, title, va="top")
        figure.text(0.015, 0.012, _CAPTION.format(1e3 * per_newton), fontsize=6.5, color=FAINT)
    return figure


def hand_figure(hand: Hand, theta: Array, body: ObjectConfig | None = None) -> Figure:
    """Draw a hand at joint angles of shape (m,), rad, alone or with an object at its first pose."""
    chains = hand.joint_positions(theta)
    points = np.vstack([np.zeros((1, 3)), *chains])
    with look():
        figure = new_figure(0.5 * PAGE, 3.1, layout="none")
        axes = _panel(figure, points)
        _draw_hand(axes, chains, hand.radii, float(np.linalg.norm(points, axis=1).max()))
        if body is not None:
            _draw_solid(axes, body.solid(), rodrigues(*body.rotation), np.array(body.position))
    return figure


def _panel(figure: Figure, points: Array, left: float = 0.0, width: float = 1.0) -> Any:
    """Return a part of a figure that shows a cube around some points."""
    axes: Any = figure.add_axes((left, 0.04, width, 0.92), projection="3d", computed_zorder=False)
    axes.view_init(elev=24.0, azim=-65.0)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
    limits = zip("xyz", middle - half, middle + half, strict=True)
    axes.set(**{f"{name}lim": ends for name, *ends in limits})
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.set_axis_off()
    return axes


def _draw_hand(axes: Any, chains: list[Array], radii: Array, reach: float) -> None:
    for name, tip in zip("xyz", _PALM_AXIS * reach * np.eye(3), strict=True):
        axes.quiver(0, 0, 0, *tip, color=INK, lw=0.9, arrow_length_ratio=0.22)
        axes.text(*(1.3 * tip), f"${name}$", ha="center", va="center", fontsize=7)
    for i, chain in enumerate(chains):
        color = finger_color(i)
        axes.plot(*np.array([np.zeros(3), chain[0]]).T, color="#d5d5d5", lw=3.0)
        axes.plot(*chain.T, color=color, lw=4.0, solid_joinstyle="round")
        axes.plot(*chain[:-1].T, "o", ms=4.5, mfc="white", mec=color, mew=1.2)
        axes.plot_surface(
            *_sphere(chain[-1], radii[i]), color=color, alpha=0.45, lw=0, rasterized=True
        )
        outside = chain[0] * (1.0 + 0.2 * reach / max(float(np.linalg.norm(chain[0])), 1e-9))
        axes.text(*outside, str(i + 1), color=color, weight="bold", fontsize=10, ha="center")


def _draw_object(axes: Any, record: Record, row: int, scenario: Scenario, reach: float) -> None:
    solid, place = scenario.plant.object.solid(), record.object_position[row]
    if not np.linalg.norm(place) < 2.0 * reach:  # unknown, or fallen away
        return
    _draw_solid(axes, solid, rotation_from_quaternion(record.object_quaternion[row]), place)


def _draw_solid(axes: Any, solid: Solid, turn: Array, place: Array) -> None:
    corners = solid.vertices @ turn.T + place
    art = optional("mpl_toolkits.mplot3d.art3d", "Drawing")
    faces = [corners[face] for face in solid.face_corners]
    for part in (
        art.Poly3DCollection(faces, facecolor="#b9c4cf", edgecolor="none", alpha=0.25, zorder=1),
        art.Line3DCollection(corners[solid.edges], color="#5d6873", lw=0.6, zorder=1),
    ):
        axes.add_collection3d(part, autolim=False)


def _draw_contacts(axes: Any, record: Record, row: int, reach: float, per_newton: float) -> None:
    """Draw contact frames and forces, the path of their centroid, and its target."""
    forces = known_part(contact_forces(record)[row])
    for i, point in enumerate(record.contact_positions[row]):
        if not np.isfinite(point).all():
            continue
        frame = rotation_from_quaternion(record.contact_quaternions[row, i])
        for axis in (0, 2):
            end = point + _CONTACT_AXIS * reach * frame[:, axis]
            axes.plot(*np.array([point, end]).T, color=AXES[axis], lw=1.3, zorder=5)
        axes.plot(*point[:, None], "o", color=INK, ms=2.5, zorder=6)
        arrow = per_newton * frame @ forces[i]
        if np.isfinite(arrow).all():
            axes.quiver(*point, *arrow, color=INK, lw=1.3, arrow_length_ratio=0.28, zorder=6)
    axes.plot(*record.auxiliary_position[: row + 1].T, color=INK, lw=0.9, zorder=6)
    goal = record.desired_position[row]
    if np.isfinite(goal).all():
        axes.plot(*goal[:, None], "x", color="#CC0000", ms=6, mew=1.6, zorder=7)
        axes.text(*goal, "  $p_d$", color="#CC0000", zorder=7)


def _sphere(center: Array, radius: float) -> Array:
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    unit = np.array([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    return np.asarray(center[:, None, None] + radius * unit)
