# SPDX-License-Identifier: Apache-2.0
"""The paper's Fig. 2: hand and object in space, at the start and at the end of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.style import (
    FAINT,
    INK,
    PAGE,
    axis_color,
    finger_color,
    look,
    new_figure,
)
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.derived import dropped_at
from tactile_hand_ros.scenario.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_ELEVATION = 24.0
_FORCE = 0.022  # length of a force arrow, m/N
_FRAME = 0.045  # length of a contact frame's axes, m
_ORIGIN = 0.1  # length of the palm frame's axes, m
_SMALL = 0.3  # reach of a hand below which everything is drawn smaller, m
_LONGEST = 0.4  # of a force arrow, as a share of the hand's reach
_CAPTION = (
    "axes at P: {axes:g} m     arrows at contacts: force on the object, {force:.2g} mm per N     "
    "black line: path of the contact centroid to its target"
)


def grasp_figure(record: Record, scenario: Scenario) -> Figure:
    """Draw hand, object, contacts and forces at the first tick with forces and at the last.

    Without ground truth the object is left out.

    Args:
        record: The run.
        scenario: Its scenario, for the hand and the shape of the object.
    """
    hand = Hand.load(scenario.hand, scenario.layout)
    solid = scenario.plant.object.solid()
    rows, dropped = (min(1, len(record) - 1), len(record) - 1), dropped_at(record)
    scenes = [_Scene(record, row, hand, solid.vertices, solid.face_corners) for row in rows]
    reach = max(float(np.linalg.norm(chain, axis=1).max()) for chain in scenes[0].chains)
    scale = min(1.0, reach / _SMALL)
    strongest = max(float(np.nanmax(scene.strengths, initial=1e-9)) for scene in scenes)
    force = min(_FORCE * scale, _LONGEST * reach / strongest)
    for scene in scenes:
        scene.scale, scene.newton = scale, force
    view = _View(_azimuth(scenes[0].chains))
    with look():
        figure = new_figure(PAGE, 3.1, layout="none")
        panels = [_panel(figure, number, view) for number in range(2)]
        for axes, scene in zip(panels, scenes, strict=True):
            scene.draw(axes, view.towards)
        everything = np.vstack([points for scene in scenes for points in scene.points])
        for axes in panels:
            _fit(axes, everything[np.isfinite(everything).all(axis=1)], view)
        for number, row in enumerate(rows):
            title = f"({'ab'[number]}) {('start', 'end')[number]}, $t$ = {record.times[row]:.3g} s"
            if number and not math.isnan(dropped):
                title += f": object dropped at {dropped:.3g} s"
            figure.text(0.015 + 0.5 * number, 0.985, title, va="top")
        caption = _CAPTION.format(axes=round(scale * _ORIGIN, 3), force=1e3 * force)
        figure.text(0.015, 0.012, caption, fontsize=6.5, color=FAINT)
    return figure


def _panel(figure: Figure, number: int, view: _View) -> Any:
    axes: Any = figure.add_axes(
        (0.5 * number, 0.04, 0.5, 0.92), projection="3d", computed_zorder=False
    )
    axes.view_init(elev=_ELEVATION, azim=view.azimuth)
    axes.set_proj_type("persp", focal_length=0.7)
    axes.set_axis_off()
    return axes


def _fit(axes: Any, points: Array, view: _View) -> None:
    """Choose centre and size of the cube of space that is shown, so that the points just fit."""
    middle, half = points.mean(axis=0), 0.5
    for _ in range(6):  # perspective makes size and place depend on each other a little
        limits = {
            f"{name}lim": (middle[i] - half, middle[i] + half) for i, name in enumerate("xyz")
        }
        axes.set(**limits)
        axes.set_box_aspect((1, 1, 1))
        axes.apply_aspect()
        ends = np.vstack([points, middle, middle + view.right, middle + view.up])
        flat = _on_screen(axes, ends) - np.array([axes.bbox.x0, axes.bbox.y0])
        low, high = flat[:-3].min(axis=0), flat[:-3].max(axis=0)
        origin, right, up = flat[-3:]
        size = np.array([axes.bbox.width, axes.bbox.height])
        off = 0.5 * (low + high) - 0.5 * size
        middle = middle + view.right * off[0] / np.linalg.norm(right - origin)
        middle = middle + view.up * off[1] / np.linalg.norm(up - origin)
        half *= float(((high - low) / (0.9 * size)).max())


def _on_screen(axes: Any, points: Array) -> Array:
    projection = optional("mpl_toolkits.mplot3d.proj3d", "Drawing")
    x, y, _ = projection.proj_transform(*points.T, axes.get_proj())
    return np.asarray(axes.transData.transform(np.column_stack([x, y])))


class _View:
    """Directions of a view from above the palm, in the palm frame."""

    def __init__(self, azimuth: float) -> None:
        a, e = np.deg2rad(azimuth), np.deg2rad(_ELEVATION)
        self.azimuth = azimuth
        self.towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        self.right = np.array([-np.sin(a), np.cos(a), 0.0])
        self.up = np.cross(self.towards, self.right)


def _azimuth(chains: list[Array]) -> float:
    """Return an oblique view in which the fingers are far apart and none hides the object."""
    tips = np.array([chain[-1] for chain in chains])
    tips = tips - tips.mean(axis=0)

    def worth(degrees: float) -> float:
        view = _View(degrees)
        apart = float(np.diff(np.sort(tips @ view.right)).min())
        in_front = np.maximum(0.0, tips @ view.towards)
        before_it = np.maximum(0.0, 1.0 - np.abs(tips @ view.right) / 0.15)
        return apart - float((in_front * before_it).max())

    oblique = [v for v in range(-180, 180, 5) if 20 <= v % 90 <= 70]
    from_the_front = sorted(oblique, key=lambda v: abs(v + 65))
    return float(max(from_the_front, key=lambda v: round(worth(v), 3)))


class _Scene:
    """What is to be seen at one tick."""

    def __init__(
        self, record: Record, row: int, hand: Hand, vertices: Array, faces: Sequence[Any]
    ) -> None:
        self.record, self.row = record, row
        self.chains = [np.array(chain) for chain in hand.joint_positions(record.theta[row])]
        self.radii = hand.radii
        rotation = rotation_from_quaternion(record.object_quaternion[row])
        self.corners = vertices @ rotation.T + record.object_position[row]
        self.faces = faces
        self.scale, self.newton = 1.0, _FORCE

    @property
    def strengths(self) -> Array:
        """The contact forces' magnitudes, shape (k,), N."""
        return np.asarray(np.linalg.norm(derived.contact_forces(self.record)[self.row], axis=1))

    @property
    def is_near(self) -> bool:
        """Whether the object is known and not farther from the tips than the hand is large."""
        if not np.isfinite(self.corners).all():
            return False
        tips = np.array([chain[-1] for chain in self.chains])
        size = max(float(np.ptp(chain, axis=0).max()) for chain in self.chains)
        away = self.corners.mean(axis=0) - tips.mean(axis=0)
        return float(np.linalg.norm(away)) <= size

    @property
    def points(self) -> list[Array]:
        """All points that must be inside the picture."""
        tips = np.array([chain[-1] for chain in self.chains])
        shifts = self.radii[:, None, None] * np.vstack([np.eye(3), -np.eye(3)])
        outer = (tips[:, None] + shifts).reshape(-1, 3)
        numbers = np.array([_number_place(chain, self.scale) for chain in self.chains])
        return [
            *self.chains,
            *(arrow for i in range(len(self.chains)) if (arrow := self._arrow(i)) is not None),
            *([self.corners] if self.is_near else []),
            outer,
            numbers,
            self.record.desired_position[[self.row]],
        ]

    def draw(self, axes: Any, camera: Array) -> None:
        self._draw_palm(axes)
        middle = np.nanmean([chain[-1] for chain in self.chains], axis=0) @ camera
        for i, chain in enumerate(self.chains):
            self._draw_finger(axes, i, 6 if chain[-1] @ camera > middle + 0.02 else 2)
        if self.is_near:
            self._draw_object(axes, camera)
        for i in range(len(self.chains)):
            self._draw_contact(axes, i)
        self._draw_goal(axes)

    def _draw_palm(self, axes: Any) -> None:
        bases = np.array([chain[0] for chain in self.chains])
        for base in bases:
            axes.plot(*np.array([np.zeros(3), base]).T, color="#d5d5d5", lw=3.0, zorder=0)
        for i, name in enumerate("xyz"):
            tip = self.scale * _ORIGIN * np.eye(3)[i]
            axes.quiver(0, 0, 0, *tip, color=INK, lw=0.9, arrow_length_ratio=0.22, zorder=1)
            axes.text(*(1.3 * tip), f"${name}$", ha="center", va="center", fontsize=7)
        axes.text(0.0, 0.0, -0.045 * self.scale, "P", ha="center", va="center", fontsize=8)

    def _draw_finger(self, axes: Any, i: int, zorder: int) -> None:
        color, chain = finger_color(i), self.chains[i]
        axes.plot(*chain.T, color=color, lw=4.0, solid_joinstyle="round", zorder=zorder)
        axes.plot(*chain[:-1].T, "o", ms=4.5, mfc="white", mec=color, mew=1.2, zorder=zorder + 0.2)
        x, y, z = _sphere(chain[-1], self.radii[i])
        axes.plot_surface(
            x, y, z, color=color, alpha=0.45, lw=0, zorder=zorder + 0.1, rcount=40, rasterized=True
        )
        axes.text(
            *_number_place(chain, self.scale),
            str(i + 1),
            color=color,
            weight="bold",
            fontsize=10,
            ha="center",
            va="center",
            zorder=9,
        )

    def _draw_object(self, axes: Any, camera: Array) -> None:
        art = optional("mpl_toolkits.mplot3d.art3d", "Drawing")
        centre = self.corners.mean(axis=0)
        for face in self.faces:
            corners = self.corners[face]
            front = float((corners.mean(axis=0) - centre) @ camera) > 0.0
            patch = art.Poly3DCollection(
                [corners],
                facecolor="#b9c4cf",
                alpha=0.22 if front else 0.30,
                edgecolor="#5d6873",
                lw=0.8 if front else 0.4,
                zorder=5 if front else 3,
            )
            axes.add_collection3d(patch)

    def _draw_contact(self, axes: Any, i: int) -> None:
        record, row = self.record, self.row
        point = record.contact_positions[row, i]
        if not np.isfinite(point).all():
            return
        frame = rotation_from_quaternion(record.contact_quaternions[row, i])
        for axis in (0, 2):
            end = point + self.scale * _FRAME * frame[:, axis]
            axes.plot(*np.array([point, end]).T, color=axis_color(axis), lw=1.3, zorder=7)
        axes.plot(*point[:, None], "o", color=INK, ms=2.5, zorder=8)
        ends = self._arrow(i)
        if ends is not None:
            arrow = ends[1] - ends[0]
            axes.quiver(*point, *arrow, color=INK, lw=1.3, arrow_length_ratio=0.28, zorder=8)

    def _arrow(self, i: int) -> Array | None:
        """Return both ends of the force at a contact, shape (2, 3), None where there is none."""
        point = self.record.contact_positions[self.row, i]
        frame = rotation_from_quaternion(self.record.contact_quaternions[self.row, i])
        force = frame @ derived.contact_forces(self.record)[self.row, i]
        known = np.isfinite(point).all() and np.isfinite(force).all()
        if not known or np.linalg.norm(force) <= 1e-9:
            return None
        return np.array([point, point + self.newton * force])

    def _draw_goal(self, axes: Any) -> None:
        path = self.record.auxiliary_position[: self.row + 1]
        axes.plot(*path.T, color=INK, lw=0.9, zorder=7)
        goal = self.record.desired_position[self.row]
        if np.isfinite(goal).all():
            axes.plot(*goal[:, None], "x", color="#CC0000", ms=6, mew=1.6, zorder=9)
            axes.text(
                *(goal + np.array([0.0, 0.0, 0.035 * self.scale])),
                "$p_d$",
                color="#CC0000",
                zorder=9,
            )


def _number_place(chain: Array, scale: float) -> Array:
    """Return where a finger's number stands: beside its base, on the outer side."""
    outward = chain[0] / max(float(np.linalg.norm(chain[0])), 1e-9)
    return np.asarray(chain[0] + scale * (0.085 * outward + np.array([0.0, 0.0, -0.02])))


def _sphere(centre: Array, radius: float) -> tuple[Array, Array, Array]:
    u, v = np.mgrid[0 : 2 * np.pi : 41j, 0 : np.pi : 21j]
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    return centre[0] + radius * x, centre[1] + radius * y, centre[2] + radius * z
