# SPDX-License-Identifier: Apache-2.0
"""The minimum grasp force that holds the true load, by linear programming."""

from __future__ import annotations

import functools
import math

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import centered, grasp_map
from tactile_hand_ros.extras import optional
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import external_wrench

SIDES = 64
"""Edges of the pyramid inside a cone; the result is too large by at most 1 / cos(pi / 64)."""


@functools.cache
def initial_grasp(scenario: str, layout: str = "") -> tuple[Contacts, Array]:
    """Return the initial contacts and center of mass, in the scenario's layout or another."""
    changes = {"layout": layout, "targets": []} if layout else {}
    plant = Plant(load_scenario(scenario, changes).plant)
    return plant.state.contacts, plant.state.position


def minimum_grasp_force(contacts: Contacts, wrench: Array, friction: float) -> float:
    """Return the minimum sum of normal forces that lets contacts carry a wrench, (12).

        min sum f_n   s.t.   sum_i R_i f_i = F,   sum_i (p_i - c) x R_i f_i = T,   |f_t| <= mu f_n

    Each force is a sum of edges (mu cos a, 1, mu sin a) of a pyramid inside its cone with
    non-negative weights. This is a linear program in the weights.

    Args:
        contacts: Contact points and frames; fingers without contact carry no force.
        wrench: Required force and torque on the object, about the centroid c of the touching
            contacts, shape (6,), N and N m.
        friction: mu of all contacts.

    Returns:
        The sum [N]; infinite if no forces inside the cones carry the wrench.
    """
    touching = contacts.touching
    if not touching.any():
        return 0.0 if not np.any(wrench) else math.inf
    points, frames = contacts.positions[touching], contacts.rotations[touching]
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.stack([np.cos(angles), np.zeros(SIDES), np.sin(angles)], axis=1)
    edges = friction * ring + np.array([0.0, 1.0, 0.0])
    arms = centered(points)
    # Scale torques by the size of the grasp, so that all rows have the same scale.
    length = max(float(np.linalg.norm(arms, axis=1).max()), 1e-6)
    blocks = grasp_map(arms / length, frames).reshape(6, -1, 3)
    rows = np.einsum("akj,sj->aks", blocks, edges).reshape(6, -1)
    goal = np.concatenate([wrench[:3], np.asarray(wrench[3:]) / length])
    scale = max(float(np.abs(goal).max()), 1e-9)
    linprog = optional("scipy.optimize", "The minimum grasp force").linprog
    result = linprog(np.ones(rows.shape[1]), A_eq=rows, b_eq=goal / scale, method="highs")
    return scale * float(result.fun) if result.status == 0 else math.inf


def minimum_against(contacts: Contacts, position: Array, wrench: Array, friction: float) -> float:
    """Return the minimum grasp force for a wrench on the object about its center of mass."""
    torque = wrench[3:] + np.cross(position - contacts.centroid, wrench[:3])
    return minimum_grasp_force(contacts, -np.concatenate([wrench[:3], torque]), friction)


def minimum_at(record: Record, scenario: Scenario, time: float, row: int) -> float:
    """Return the minimum grasp force for the true load and friction of a scenario at a time [s].

    Contacts and pose of the object are those of a row of the record.
    """
    plant = scenario.plant
    contacts = Contacts.from_poses(record.true_positions[row], record.true_quaternions[row])
    wrench = external_wrench(plant.disturbances, time)
    wrench[:3] += plant.object.mass * np.array(plant.gravity)
    friction = plant.object.friction
    for change in plant.friction_changes:
        friction = change.friction if change.start <= time else friction
    return minimum_against(contacts, record.object_position[row], wrench, friction)
