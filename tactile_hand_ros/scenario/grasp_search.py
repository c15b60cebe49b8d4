# SPDX-License-Identifier: Apache-2.0
"""Joint angles at which a hand holds an object: one finger on one side, the others opposite.

A least-squares search from many random postures, with one residual for each demand: tips touch
their faces or a round surface, away from the edges, on their hemispheres, apart from each other and
facing each other, and joints stay away from their ends. What is found is ranked by the load that
the weakest joint permits with the friction that a hand expects before it has slipped.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import (
    Contacts,
    contact_frame,
    face_frame,
    hand_jacobian,
    in_palm,
    joint_torques,
)
from tactile_hand_ros.control.controller import FEWEST_MOTIONS, LEAST_ROOM
from tactile_hand_ros.control.grasp import check_joints, check_spread, joint_margin, wrench_forces
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.control.reach import end_of, room
from tactile_hand_ros.control.slip.regulator import SlipRegulatorConfig
from tactile_hand_ros.control.stability import motions_of_object
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import SHORTEST_LEVER, Hand
from tactile_hand_ros.rotations import rodrigues, vector_from_rotation
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.simulation.plant_config import ObjectConfig
from tactile_hand_ros.simulation.solid import closest_point

STARTS = 40
"""Random postures for each choice of faces and of the finger that is alone."""

_EDGE = 0.25  # of half an edge, distance that contacts keep from the edges
_TOP = np.cos(np.radians(60.0))  # of the angle between a contact and the top of its hemisphere
_GAP = 0.002  # m between two fingertips
_MIDDLE = 0.03  # weight of joint angles in the middle of their range
_OUTSIDE = 0.9  # of the range of a joint, from which more is avoided
_NO_SPAN = 1e-9  # rad or m, range of a joint that cannot move
_PRESS = 0.25  # of a normal; below, a tip moves sideways four times as far as it presses
_ROOM = 0.25  # of the ways to joint limits and rims, that a grasp needs to be moved
_TOUCH = 1e-4  # m; further away, a tip does not touch
_GAIN = 0.01  # of the sum of squares; steps that gain less hardly change the order of the grasps
# Observer of a hand that keeps its posture at the bandwidth w = 125 rad/s of a hold at 1 kHz. The
# weight of an object whose inertia is r times that of the fingers is carried stably where
# (1 + 2 w T) (2 w + w^2 T) > (1 + r) w^2 T: here for r < 29, s.
_SLOW = 0.1
_BITS = 14  # of the encoders, as most hands have
_COMPLIANCE = 5e-5  # m/N, hard rubber; rigid tips leave it to chance what bearings carry


@dataclass(frozen=True)
class FoundGrasp:
    """A grasp of an object.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        position: Center of the object, palm frame, shape (3,), m.
        rotation: Its rotation vector, shape (3,), rad.
        contacts: Contacts of the fingers, palm frame.
        friction: Friction coefficient that f* needs.
        grasp_force: k_f that friction needs for that load, N.
        room: Smallest fraction left of the ways to joint limits and rims; see `reach.room`.
        load: Largest force on the object, in any direction, at which all joints stay inside their
            limits, N.
        motions: Directions of 6 in which the joints move the object.
        press: Smallest part of a contact normal in the directions in which its finger moves, 0 to
            1. What a finger cannot press itself, its tip slips along before it is stopped.
        lever: Smallest singular value of J_h (A5), as a fraction of the largest.
    """

    theta: Array
    position: Array
    rotation: Array
    contacts: Contacts
    friction: float
    grasp_force: float
    room: float
    load: float
    motions: int
    press: float
    lever: float

    @property
    def worth(self) -> float:
        """The load, N, times a factor of 0 to 1 for each of room, press and lever."""
        enough = min(1.0, self.room / _ROOM) * min(1.0, self.lever / SHORTEST_LEVER)
        return self.load * self.press * enough


def expected_friction(friction: float) -> float:
    """Return the friction coefficient that a new grasp relies on, for the true one."""
    config = SlipRegulatorConfig()
    return min(friction, config.friction.prior) * (1.0 - config.reflex.margin)


def search(
    hand: Hand, body: ObjectConfig, advance: Callable[[str], None] = lambda _: None
) -> list[FoundGrasp]:
    """Return the grasps that were found, the one that carries most first.

    A grasp counts less if there is no room to move, if fingers do not press along their normals, or
    if the joints hardly move a contact in some direction. `advance` is called after each start with
    what is tried; there are `number_of_starts`.

    Raises:
        GraspError: If there is none, with the reasons that came up most.
    """
    relied, links = expected_friction(body.friction), LinkCollisions(hand, body.solid())
    random, found, reasons = np.random.default_rng(0), list[FoundGrasp](), list[str]()
    for alone, axis in _choices(hand, body):
        problem = (_Problem if body.shape == "box" else _RoundProblem)(hand, body, alone, axis)
        for _ in range(STARTS):
            try:
                grasp = problem.solve(random, relied)
                inside = links.touching(grasp.theta, grasp.position, rodrigues(*grasp.rotation))
                if inside:
                    raise GraspError(f"{inside[0]} would be inside the object")
                found.append(grasp)
            except GraspError as error:
                reasons.append(str(error))
            advance(f"{hand.finger_names[alone]} against the others")
    if not found:
        most = ", then ".join(reason for reason, _ in Counter(reasons).most_common(2))
        raise GraspError(
            f"no grasp of a {body.shape} of {' x '.join(f'{1e3 * edge:g}' for edge in body.size)} "
            f"mm was found from {len(reasons)} postures; most often {most}. Try another size, or "
            "check limits, axis and center of the tips with `tactile-hand hand`"
        )
    return sorted(found, key=lambda grasp: -grasp.worth)


def scenario_values(hand: str, body: ObjectConfig, found: FoundGrasp) -> dict[str, Any]:
    """Return a scenario in which a hand, by name or file, holds the object, as data for YAML.

    The grasp force starts at one and a half times what the weight needs, and stays inside what the
    joints bear and the regulator's own limit.
    """
    needed = 9.81 * body.mass / (expected_friction(body.friction) - found.friction)
    largest = min(found.grasp_force, SlipRegulatorConfig.model_fields["maximum"].default)
    few = found.motions < FEWEST_MOTIONS
    return {
        "extends": "human_hold",
        "description": f"A {body.shape} of {body.mass:.3g} kg, held with angles from a search.",
        "hand": hand,
        "layout": "",
        "targets": [],
        "plant": {
            "encoder": {"bits": _BITS},
            "contact": {"compliance": _COMPLIANCE},
            "initial_joints": _rounded(found.theta),
            "object": {
                "shape": body.shape,
                "size": list(body.size),
                "mass": round(body.mass, 4),
                "friction": body.friction,
                "position": _rounded(found.position),
                "rotation": _rounded(found.rotation),
            },
        },
        "slip_regulator": {
            "grasp_force": round(min(1.5 * needed, largest), 3),
            "maximum": round(largest, 3),
        },
        "manipulation_controller": {"law": {"observer": {"time": _SLOW}}} if few else {},
    }


def _pressing(jacobian: Array, normal: Array) -> float:
    """Return the part of a normal, shape (3,), in the velocities of a tip, J of shape (3, m)."""
    directions, speeds, _ = np.linalg.svd(jacobian, full_matrices=False)
    return float(np.linalg.norm(normal @ directions[:, speeds > SHORTEST_LEVER * speeds[0]]))


def _rounded(values: Array) -> list[float]:
    return [round(float(value), 6) for value in values]


def number_of_starts(hand: Hand, body: ObjectConfig) -> int:
    """Return how many postures `search` starts from; see there."""
    return STARTS * len(list(_choices(hand, body)))


def _choices(hand: Hand, body: ObjectConfig) -> Iterator[tuple[int, int]]:
    """Yield which finger is alone, and the axis of the object along which it presses."""
    axes = {edge: axis for axis, edge in enumerate(body.size)}  # of equal edges one suffices
    if body.shape != "box":
        axes = {body.size[0]: 0}
    return itertools.product(range(hand.fingers), axes.values())


class _Problem:
    """One choice of faces: the finger `alone` presses along an axis of the box, the others back."""

    def __init__(self, hand: Hand, body: ObjectConfig, alone: int, axis: int) -> None:
        self._hand, self._alone, self._axis = hand, alone, axis
        self._half, self._shape = 0.5 * np.array(body.size), body.solid().shape
        self._sides = np.where(np.arange(hand.fingers) == alone, -1.0, 1.0)  # of the box
        self._others = self._sides > 0.0
        self._across = self._to_edges(body)
        self._edges = self._half[self._across]
        self._pairs = list(itertools.combinations(range(hand.fingers), 2))
        lower, upper = (np.clip(limit, -np.pi, np.pi) for limit in hand.position_limits)
        self._lower, self._upper = lower, upper
        self._span = np.maximum(upper - lower, _NO_SPAN)
        self._scale = float(self._half.min())

    def _to_edges(self, body: ObjectConfig) -> list[int]:
        """Return the axes along which the sides of a body end in edges."""
        return [i for i in range(3) if i != self._axis]

    def solve(self, random: Any, friction: float) -> FoundGrasp:
        """Return a grasp from a random posture, or raise GraspError."""
        optimize = optional("scipy.optimize", "Searching for a grasp")
        theta = self._lower + random.uniform(0.2, 0.7, self._hand.joints) * self._span
        start = np.concatenate([theta, *self._placed(theta, random)])
        bounds = np.full(len(start), np.inf)
        bounds[: len(theta)] = self._upper + _NO_SPAN
        below = np.concatenate([self._lower - _NO_SPAN, np.full(6, -np.inf)])
        x = optimize.least_squares(
            self._residuals, start, bounds=(below, bounds), ftol=_GAIN, max_nfev=60, x_scale="jac"
        ).x
        return self._judged(x, friction)

    def _placed(self, theta: Array, random: Any) -> tuple[Array, Array]:
        """Return a pose of the box between the fingertips: position and rotation vector."""
        tips = self._hand.tip_positions(theta)
        others = tips[self._others].mean(axis=0)
        along = others - tips[self._alone]
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        sides = random.standard_normal((2, 3))
        sides /= np.linalg.norm(sides, axis=1)[:, None]
        frame = np.roll(face_frame(along, *sides), self._axis - 1, axis=1)  # from [t_x, n, t_z]
        return 0.5 * (others + tips[self._alone]), vector_from_rotation(frame)

    def _seen(self, x: Array) -> tuple[Array, Array, Array]:
        """Return tips in the frame of the box, shape (k, 3), its rotation and the joint angles."""
        theta, position, turn = x[: self._hand.joints], x[-6:-3], rodrigues(*x[-3:])
        return (self._hand.tip_positions(theta) - position) @ turn, turn, theta

    def _touched(self, tips: Array) -> tuple[Array, Array]:
        """Return gaps, shape (k,), m, and inward normals, shape (k, 3), of tips in its frame."""
        gaps = self._sides * tips[:, self._axis] - self._half[self._axis] - self._hand.radii
        return gaps, -self._sides[:, None] * np.eye(3)[self._axis]

    def _facing(self, tips: Array, normals: Array) -> Array:
        """Return how far the finger that is alone is from facing the others, any shape.

        Two contacts face each other through the center of mass, as they resist no turn about their
        line.
        """
        if len(tips) == 2:
            return np.asarray(tips[:, self._across] / self._scale).ravel()
        others = tips[self._others][:, self._across].mean(axis=0)
        return np.asarray((tips[self._alone, self._across] - others) / self._scale)

    def _residuals(self, x: Array) -> Array:
        tips, turn, theta = self._seen(x)
        hand, (gaps, normals) = self._hand, self._touched(tips)
        sideways = np.abs(tips[:, self._across]) - (1.0 - _EDGE) * self._edges
        tops = hand.tip_rotations(theta)[:, :, 0]
        lean = _TOP - (tops * (normals @ turn.T)).sum(axis=1)
        apart = [
            hand.radii[i] + hand.radii[j] + _GAP - np.linalg.norm(tips[i] - tips[j])
            for i, j in self._pairs
        ]
        middle = 2.0 * (theta - self._lower) / self._span - 1.0
        return np.concatenate(
            [
                gaps / (0.01 * self._scale),
                np.maximum(0.0, sideways).ravel() / (0.1 * self._scale),
                3.0 * np.maximum(0.0, lean),
                self._facing(tips, normals),
                np.maximum(0.0, apart) / (0.1 * self._scale),
                _MIDDLE * middle,
                5.0 * np.maximum(0.0, np.abs(middle) - _OUTSIDE),
            ]
        )

    def _judged(self, x: Array, friction: float) -> FoundGrasp:
        tips, turn, theta = self._seen(x)
        hand, (gaps, inward) = self._hand, self._touched(tips)
        normals = inward @ turn.T
        if np.abs(gaps).max() > _TOUCH:
            worst = hand.finger_names[int(np.abs(gaps).argmax())]
            raise GraspError(f"{worst} does not reach its side")
        if (np.abs(tips[:, self._across]) > self._edges).any():
            raise GraspError("a contact is beyond an edge")
        points = x[-6:-3] + tips @ turn.T + hand.radii[:, None] * normals
        contacts = Contacts(points, np.array([contact_frame(normal) for normal in normals]))
        ways, fingertips = room(hand, theta, contacts), hand.fingertips(theta)
        left = float(ways.min())
        if left < LEAST_ROOM:
            raise GraspError(f"no room is left of the way of {end_of(hand, int(ways.argmin()))}")
        try:
            check_spread(points)
            jacobian = hand_jacobian(fingertips, points, contacts.rotations)
            check_joints(jacobian)
        except GraspError as error:
            reason = "contacts are on one line, or the hand is singular (A5, A7)"
            raise GraspError(reason) from error
        longest = float(np.linalg.norm(jacobian.reshape(-1, hand.joints), 2))
        presses = list(map(_pressing, fingertips.linear, normals))
        if (press := min(presses)) < _PRESS:
            weakest = hand.finger_names[presses.index(press)]
            raise GraspError(f"{weakest} cannot press where it touches")
        optimal = ForceOptimizer(ForceOptimizerConfig(), hand.fingers).solve(contacts)
        if not optimal.ok:
            raise GraspError(optimal.reason)
        normal, sideways = optimal.forces[:, 1], np.hypot(*optimal.forces[:, [0, 2]].T)
        needed = float((sideways / normal).max()) if (normal > 0.0).all() else np.inf
        if needed >= friction:
            raise GraspError(f"friction of {friction:g} does not hold it")

        def torques(forces: Array) -> Array:
            return joint_torques(fingertips, points, forces)

        pressing = torques(in_palm(contacts.rotations, optimal.forces, 1.0))
        carrying = [torques(wrench_forces(points, wrench)) for wrench in np.eye(3, 6)]
        # Worst torque of each joint per newton of load: of the k_f for it, and of the load itself.
        used = np.abs(pressing) / (friction - needed) + np.linalg.norm(carrying, axis=0)
        load = float(((hand.effort_limits - np.abs(hand.gravity_torque(theta))) / used).min())
        if load <= 0.0:
            raise GraspError("the joints cannot carry the fingers")
        return FoundGrasp(
            theta.copy(),
            x[-6:-3].copy(),
            vector_from_rotation(turn),
            contacts,
            friction=needed,
            grasp_force=load / (friction - needed),
            room=left,
            load=load,
            motions=motions_of_object(hand, theta, contacts),
            press=press,
            lever=joint_margin(jacobian) / longest,
        )


class _RoundProblem(_Problem):
    """The same for a round body, whose contacts may be anywhere on its side."""

    def _to_edges(self, body: ObjectConfig) -> list[int]:
        return [2] if body.shape == "cylinder" else []

    def _touched(self, tips: Array) -> tuple[Array, Array]:
        found = [closest_point(self._shape, tip) for tip in tips]
        distances, outward = (np.array(each) for each in zip(*found, strict=True))
        return distances - self._hand.radii, -outward

    def _facing(self, tips: Array, normals: Array) -> Array:
        """Return by how much both sides miss the line of action through the center of mass."""
        sides = np.array([tips[self._alone], tips[self._others].mean(axis=0)]) / self._scale
        along = np.outer(sides @ normals[self._alone], normals[self._alone])
        return np.asarray(sides - along).ravel()
