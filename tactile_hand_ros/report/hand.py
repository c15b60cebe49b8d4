# SPDX-License-Identifier: Apache-2.0
"""A hand as its users should check it: joints in their order, limits, couplings and tips."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.scene import hand_figure
from tactile_hand_ros.report.style import save
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.simulation.solid import Solid

JOINT_COLUMNS = ("joint", "moves", "range, rad", "torque, N m", "speed, rad/s", "also moves")
FINGER_COLUMNS = ("finger", "joints", "radius, mm", "fitted to, mm", "reach, mm", "force, N")

_ENDLESS = 500.0  # N m or N, far above any hand
_CLOSED = 0.4  # of the range of each joint, where the hand is drawn and its strength computed


def example_posture(hand: Hand) -> Array:
    """Return joint angles at which the fingers are half closed, shape (m,), rad."""
    lower, upper = (np.clip(limit, -np.pi, np.pi) for limit in hand.position_limits)
    return np.asarray(lower + _CLOSED * (upper - lower))


def joint_rows(hand: Hand) -> list[list[str]]:
    """Return the driven joints as text, with the columns of `JOINT_COLUMNS`."""
    limits = zip(*hand.position_limits, hand.effort_limits, hand.velocity_limits, strict=True)
    rows = []
    for i, (name, (low, high, effort, speed)) in enumerate(
        zip(hand.joint_names, limits, strict=True)
    ):
        fingers = [hand.finger_names[k] for k in np.flatnonzero(hand.moves[:, i])]
        followers = [
            f"{follower} = {c.ratio:g} q {c.offset:+g}"
            for follower, c in hand.couplings.items()
            if c.joint == name
        ]
        numbers = f"{low:.3g} to {high:.3g}", f"{effort:.3g}", f"{speed:.3g}"
        rows.append([name, ", ".join(fingers), *numbers, ", ".join(followers)])
    return rows


def finger_rows(hand: Hand) -> list[list[str]]:
    """Return the fingers as text, with the columns of `FINGER_COLUMNS`.

    The force is what the weakest joint of a finger bears in the worst direction.
    """
    levers = np.linalg.norm(hand.fingertips(example_posture(hand)).linear, axis=1)
    with np.errstate(divide="ignore"):
        strengths = np.where(levers > 0.0, hand.effort_limits / levers, np.inf).min(axis=1)
    lengths = 1e3 * np.stack([hand.radii, hand.tip_errors, hand.spans], axis=1)
    rows = zip(hand.finger_names, hand.moves.sum(axis=1), lengths, strengths, strict=True)
    return [
        [
            name,
            str(joints),
            f"{radius:.3g}",
            f"{error:.2g}" if error else "",
            f"{span:.0f}",
            f"{n:.2g}",
        ]
        for name, joints, (radius, error, span), n in rows
    ]


def notes(hand: Hand) -> list[str]:
    """Return what users should know of the hand's file, in sentences."""
    found, use = [], "uses" if hand.has_losses else "ignores"
    losses = {"damping": (hand.damping, "N m s/rad"), "friction": (hand.friction, "N m")}
    for name, (values, unit) in losses.items():
        if values.any():
            text = f"{name}: the file states {values[values > 0.0].min():.3g} to {values.max():.3g}"
            found.append(f"{text} {unit}, which the simulation {use} (`joint_losses` in the YAML)")
    names = np.array(hand.joint_names)
    weak = ", ".join(names[hand.friction >= hand.effort_limits])
    if hand.has_losses and weak:
        found.append(f"{weak}: friction is above the largest torque; nothing moves")
    if free := ", ".join(names[hand.effort_limits >= _ENDLESS]):
        found.append(
            f"{free}: the file states no torque limit, or one of no hand; give it "
            "under 'limits' in the YAML, or under 'couplings' for a joint that follows another"
        )
    if not LinkCollisions(hand, Solid.box(np.ones(3))).names:
        found.append("without collision shapes of links, no check can detect them in an object")
    return found


def draw(hand: Hand, folder: Path, name: str) -> list[Path]:
    """Draw the hand half closed, and return the files."""
    return save(hand_figure(hand, example_posture(hand)), folder, name)
