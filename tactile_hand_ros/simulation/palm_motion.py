# SPDX-License-Identifier: Apache-2.0
"""Rotation of the palm in the world about its origin, as by the forearm of the user."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.rotations import Vector, rotation_from_vector, vector_from_rotation

_QUICKNESS = 5.0  # 1/s; a forearm turns to where its user wants it in about a second, 5 / 5 s
_REACHED = 1e-6  # rad, and rad/s; far below what a hand could sense


class PalmTurn(Config):
    """An orientation of the palm in the world and its time."""

    time: float = param(..., "when it is reached", unit="s", ge=0.0)
    rotation: Vector = param(..., "rotation vector of the palm in the world", unit="rad")


class Turning(NamedTuple):
    """Rotation and its rates of the palm at one instant.

    Attributes:
        rotation: Palm in the world, shape (3, 3).
        rate: Angular velocity, palm axes, shape (3,), rad/s.
        acceleration: Its derivative, shape (3,), rad/s^2.
    """

    rotation: Array
    rate: Array
    acceleration: Array


def resting(rotation: Array) -> Turning:
    """Return no motion, at a rotation of the palm in the world, shape (3, 3)."""
    return Turning(rotation, np.zeros(3), np.zeros(3))


def palm_turning(turns: Sequence[PalmTurn], time: float) -> Turning:
    """Return the motion of the palm at a time, s.

    It starts unturned. Between two orientations it turns about one axis with minimum jerk, from
    rest to rest (Flash and Hogan 1985): s = 10 x^3 - 15 x^4 + 6 x^5 of the way after x of the time.
    """
    at, start = np.eye(3), 0.0
    for turn in turns:
        goal = rotation_from_vector(turn.rotation)
        way, lasts = vector_from_rotation(at.T @ goal), turn.time - start
        if time < turn.time:
            x = max(0.0, (time - start) / lasts)
            s = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
            rate = 30.0 * x * x * (1.0 - x) ** 2 / lasts
            gain = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / lasts**2
            return Turning(at @ rotation_from_vector(s * way), rate * way, gain * way)
        at, start = goal, turn.time
    return resting(at)


def turned_by_user(now: Turning, goal: Vector, h: float) -> Turning:
    """Return the motion a time h, s, later, of a user who may want another orientation any time.

    Towards a rotation vector, rad: critically damped, about one axis. With the way w that is left
    and the angular velocity W, W' = k^2 w - 2 k W.
    """
    (rotation, rate, _), k = now, _QUICKNESS
    wanted = rotation_from_vector(goal)
    way = vector_from_rotation(rotation.T @ wanted)
    if max(np.abs(way).max(), np.abs(rate).max()) < _REACHED:
        return resting(wanted)
    gain = k * k * way - 2.0 * k * rate
    rate = rate + h * gain
    return Turning(rotation @ rotation_from_vector(h * rate), rate, gain)


def turned_by(outer: Turning, inner: Turning) -> Turning:
    """Return the motion R = R_outer R_inner; the rates of both are in their own turned axes."""
    carried = inner.rotation.T @ outer.rate
    return Turning(
        outer.rotation @ inner.rotation,
        carried + inner.rate,
        inner.rotation.T @ outer.acceleration + inner.acceleration + np.cross(carried, inner.rate),
    )


def apparent_wrench(turning: Turning, body: tuple[float, Array], motion: Sequence[Array]) -> Array:
    """Return the apparent force and torque on a body in a turning palm, shape (6,), N and N m.

    In the axes of the palm, with its angular velocity W and acceleration A, the mass, kg, and
    inertia (3, 3), kg m^2, of a body at r, and its velocity v and angular velocity w against the
    palm,

        f = -m (A x r + W x (W x r) + 2 W x v),
        t = -(W x I (W + w) + w x I W - I (w x W) + I A).
    """
    (_, spin, gain), (mass, inertia), (place, velocity, own) = turning, body, motion
    force = np.cross(gain, place) + np.cross(spin, np.cross(spin, place) + 2.0 * velocity)
    torque = np.cross(spin, inertia @ (spin + own)) + np.cross(own, inertia @ spin)
    torque += inertia @ (gain - np.cross(own, spin))
    return np.concatenate([-mass * force, -torque])
