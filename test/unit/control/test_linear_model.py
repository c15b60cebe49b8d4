# SPDX-License-Identifier: Apache-2.0
"""Hand, object, law and load observer as a linear system: an independent check of fitted gains."""

import numpy as np
import pytest
from support.plants import pressing, rates_of_twists

from tactile_hand_ros.control.stability import fitted_gains
from tactile_hand_ros.rotations import cross
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

TOUCH, INTEGRAL = 0.002, 0.5  # s
TALL = {"plant.object.size": [0.04, 0.04, 0.09], "plant.object.position": [0.0, 0.0, 0.0819]}
WIDE = {"plant.object.size": [0.09, 0.04, 0.04], "plant.object.position": [0.02, 0.0, 0.0619]}


def growth(changes, mass, time, load=1.0):
    """Return the largest real part of the poles, 1/s, if a fraction of the weight is the load."""
    plant = Plant(load_scenario("human_hold", changes | {"plant.object.mass": mass}).plant)
    hand, theta, contacts = plant.hand, plant.state.theta, plant.state.contacts
    gains = fitted_gains(hand, theta, contacts, pressing(plant), 1e-3, 0.015, time, 5e-5)
    weight = mass * np.array(plant.config.gravity) * load
    damping, stiffness = gains.at(8.0, float(np.linalg.norm(weight)))
    rates = rates_of_twists(plant)  # and with them inertia, damping and stiffness there
    inertia = rates.T @ hand.dynamics(theta, np.zeros(9)).inertia @ rates
    damping, stiffness = rates.T @ damping @ rates, stiffness * np.repeat([1.0, 2.0], 3)
    # The object's inertia about the centroid, and the moment of its weight as it turns.
    lever = np.array(plant.config.object.position) - contacts.centroid
    shift = np.hstack([np.eye(3), -np.array([cross(e, lever) for e in np.eye(3)])])
    body, size = mass * shift.T @ shift, np.array(plant.config.object.size)
    body[3:, 3:] += mass / 12.0 * np.diag((size**2).sum() - size**2)
    moment, one, no = np.zeros((6, 6)), np.eye(6), np.zeros((6, 6))
    moment[3:, 3:] = np.transpose([np.cross(np.cross(e, lever), weight) for e in np.eye(3)])
    # States: pose, twist, touch, observed load, integral; f = body a - moment x, touch is late.
    torques = np.hstack([moment - stiffness, -damping, no, one, one])
    twist = np.linalg.solve(inertia + body, torques)
    forces = body @ twist - np.hstack([moment, *[no] * 4])
    touch = (forces - np.hstack([no, no, one, no, no])) / TOUCH
    observed = np.hstack([no, no, one, -one, no]) / max(time, gains.observes)
    rows = np.hstack([no, one, no, no, no]), twist, touch, observed
    rows = np.vstack([*rows, np.hstack([-stiffness / INTEGRAL, *[no] * 4])])
    return np.linalg.eigvals(rows).real.max()


@pytest.mark.parametrize(("changes", "mass"), [({}, 0.1), ({}, 0.3), (TALL, 0.3), (WIDE, 0.3)])
@pytest.mark.parametrize("gravity", [[0.0, 0.0, -9.81], [-9.81, 0.0, 0.0], [0.0, 6.9, 6.9]])
def test_what_a_hand_holds_comes_to_rest_also_on_a_support(changes, mass, gravity):
    assert max(growth(changes | {"gravity": gravity}, mass, 0.015, load) for load in (0, 1)) < 0.0


def test_a_slow_observer_lets_an_object_above_its_contacts_topple():
    assert growth(TALL, 0.3, 0.04) > 1.0
