# SPDX-License-Identifier: Apache-2.0
"""Plants to test with, and torques that produce given contact forces."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from support.equations import grasp_map, hand_jacobian
from support.hands import kinetic_energy, potential_energy
from tactile_hand_ros.control.contact import in_palm
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.simulation.mujoco_plant import make_plant
from tactile_hand_ros.simulation.plant import Plant, PlantState
from tactile_hand_ros.simulation.plant_config import PlantConfig

Array = NDArray[np.float64]


def plant(step: float = 0.001, **values: Any) -> Plant:
    """Return a plant with one step per tick; values by dotted name, as in a YAML file."""
    changes = {"time_step": step, "rate": 1.0 / step, **values}
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return make_plant(PlantConfig().changed(changes))


def after(plant: Plant, ticks: int, torque: ArrayLike = 0.0) -> PlantState:
    """Advance a plant under a constant torque of the joints and return its state."""
    torques = np.full(plant.hand.joints, torque)
    for _ in range(ticks):
        state = plant.advance(torques)
    return state


def jacobian(plant: Plant, state: PlantState) -> Array:
    """Return J_h at a state, shape (3k, m); for tips without contact, of their centers."""
    tips = plant.hand.fingertips(state.theta)
    points = np.where(np.isfinite(state.contacts.positions), state.contacts.positions, 0.0)
    points = np.where(state.contacts.touching[:, None], points, tips.positions)
    return hand_jacobian(*tips, points)


def rates_of_twists(plant: Plant) -> Array:
    """Return the joint rates per twist of the object about the contacts' centroid, (3k, 6)."""
    contacts = plant.state.contacts
    twists = grasp_map(contacts.positions, contacts.centroid).T
    return np.linalg.solve(jacobian(plant, plant.state), twists)


def pressing(plant: Plant) -> Array:
    """Return the internal forces of a k_f of 1 N in palm axes, shape (k, 3), N."""
    contacts = plant.state.contacts
    optimizer = ForceOptimizer(ForceOptimizerConfig(), plant.hand.fingers)
    return in_palm(contacts.rotations, optimizer.solve(contacts).forces, 1.0)


def torque_for(plant: Plant, forces: Array, damping: float = 0.0) -> Array:
    """Return the torques for fingertip forces, shape (k, 3), palm axes, at rest."""
    state = plant.state
    weight = plant.hand.gravity_torque(state.theta)
    return jacobian(plant, state).T @ np.ravel(forces) + weight - damping * state.rates


def holding(plant: Plant, forces: Array) -> Iterator[PlantState]:
    """Yield the states while a posture is held stiffly around fingertip forces in palm axes."""
    posture, torque = plant.state.theta, torque_for(plant, forces)
    while True:
        now = plant.state
        yield plant.advance(torque + 200.0 * (posture - now.theta) - 4.0 * now.rates)


def squeeze(state: PlantState, size: float) -> Array:
    """Return forces along the normals that balance in the layout `pinch`, shape (3, 3)."""
    return size * np.array([[0.25], [0.25], [0.5]]) * state.contacts.normals


def forces_in_palm(state: PlantState) -> Array:
    """Return the contact forces on the object in palm axes, shape (k, 3), N; 0 without contact."""
    rotations = np.where(np.isfinite(state.contacts.rotations), state.contacts.rotations, 0.0)
    return (rotations @ state.forces[:, :, None])[:, :, 0]


def momentum(plant: Plant, state: PlantState) -> tuple[Array, Array]:
    """Return linear and angular momentum of the object about its center of mass."""
    config = plant.config.object
    inertia = state.rotation @ config.inertia_about(config.solid()) @ state.rotation.T
    return config.mass * state.velocity, inertia @ state.spin


def energy_of(plant: Plant) -> float:
    """Return kinetic and potential energy of links and object, J."""
    state, c = plant.state, plant.config.object
    linear, angular = momentum(plant, state)
    body = 0.5 * (linear @ state.velocity + angular @ state.spin)
    links = kinetic_energy(plant.hand, state.theta, state.rates)
    height = -c.mass * (np.array(plant.config.gravity) @ state.position)
    return float(body + links + potential_energy(plant.hand, state.theta) + height)
