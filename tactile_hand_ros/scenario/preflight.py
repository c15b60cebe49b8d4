# SPDX-License-Identifier: Apache-2.0
"""Check whether a scenario can work at all, before anything is started."""

from __future__ import annotations

import warnings

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts, hand_jacobian
from tactile_hand_ros.control.controller import NO_POSES
from tactile_hand_ros.control.grasp import VirtualFrame, check_joints, check_spread
from tactile_hand_ros.control.laws import LAWS, AuxiliaryPose, LawConfig, LawInput, law_of
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer
from tactile_hand_ros.control.reach import check_reach
from tactile_hand_ros.control.stability import largest_damping, largest_stiffness
from tactile_hand_ros.errors import ConfigurationError, GraspError, PoseError, TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.mujoco_plant import make_plant
from tactile_hand_ros.simulation.plant import Plant

_HULL_EXCESS = 0.03  # of the volume of a mesh; 500 corners of a ball lack 1 %


def check_scenario(scenario: Scenario) -> None:
    """Build hand and object, and check the first grasp (A5, A7, (13)) and the reach of all targets.

    A warning reports a mesh whose convex hull is another body.

    Raises:
        HandModelError: If the hand cannot be built.
        ObjectModelError: If the object cannot be built or does not fit into the hand.
        GraspError: If too few fingers touch, the hand is singular or the normals cannot balance.
        PoseError: If a target is out of reach.
        ConfigurationError: If a value does not fit the hand, a gain is unstable at this rate, or a
            user law fails.
    """
    plant = make_plant(scenario.plant)
    _warn_of_shapes(scenario, plant)
    theta, contacts = plant.state.theta, plant.state.contacts
    law = scenario.manipulation_controller.law
    _check_posture(plant.hand, theta)
    _check_touch(plant, law)
    hand, contacts = plant.hand.part(contacts.touching), contacts.part(contacts.touching)
    check_spread(contacts.positions)
    tips = hand.fingertips(theta)
    check_joints(hand_jacobian(tips, contacts.positions, contacts.rotations))
    optimal = ForceOptimizer(scenario.force_optimizer, hand.fingers).solve(contacts)
    if not optimal.ok:
        raise GraspError(optimal.reason)
    _check_mode(scenario)
    grasp = hand, theta, contacts
    _check_targets(scenario, grasp)
    _check_gains(scenario, grasp, plant.body_inertia)
    if law.name not in LAWS:
        grasp_force = scenario.slip_regulator.grasp_force
        _check_own_law(law, hand, LawInput(tips, contacts, optimal.forces, grasp_force))


_Grasp = tuple[Hand, Array, Contacts]  # the fingers that touch, joint angles and contacts


def _warn_of_shapes(scenario: Scenario, plant: Plant) -> None:
    """Warn of a hull that is not the mesh, and of an object inside the links."""
    if abs(excess := plant.solid.excess) > _HULL_EXCESS:
        warnings.warn(
            f"{scenario.plant.object.mesh}: fingers touch its convex hull, whose volume differs by "
            f"{100.0 * excess:+.1f} % from that of the mesh; use a mesh with smaller dents",
            stacklevel=3,
        )
    state, links = plant.state, LinkCollisions(plant.hand, plant.solid)
    if inside := links.touching(state.theta, state.position, state.rotation):
        warnings.warn(
            f"the object starts inside {', '.join(inside)}, which the simulation ignores; "
            "place it elsewhere, as `tactile-hand grasp` does",
            stacklevel=3,
        )


def _check_touch(plant: Plant, law: LawConfig) -> None:
    """Reject a start with too few contacts for a law."""
    hand, state = plant.hand, plant.state
    contacts, needed = state.contacts, "at least three" if law.uses_optimal_forces else "all"
    if contacts.all_touching or (contacts.enough_touching and law.uses_optimal_forces):
        return
    i = int(np.flatnonzero(~contacts.touching)[0])
    raise GraspError(
        f"{hand.finger_names[i]} starts {1e3 * state.gaps[i]:.1f} mm away from the object; "
        f"{needed} fingers must touch: change initial_joints, the layout, or the object's size "
        "or place"
    )


def _check_targets(scenario: Scenario, grasp: _Grasp) -> None:
    """Reject a target out of reach; what it keeps is that of the target before."""
    hand, theta, contacts = grasp
    frame = VirtualFrame().orientation(contacts.positions)
    pose = there = AuxiliaryPose(contacts.centroid, frame)
    for target in scenario.targets:
        wanted = target.target().kept(there)
        check_reach(hand, theta, contacts, pose, wanted)
        there = AuxiliaryPose(wanted.position, wanted.orientation)


def _check_gains(scenario: Scenario, grasp: _Grasp, body: Array) -> None:
    """Reject gains that are unstable at this rate; `body` is the inertia of the object."""
    law, tick = scenario.manipulation_controller.law, 1.0 / scenario.plant.rate
    most = {"damping": largest_damping(*grasp, body, tick)}
    if law.damping > 0.0:
        most["k_p"], most["k_o"] = largest_stiffness(*grasp, law.damping, 0.5 * tick)
    for name, largest in most.items():
        if (given := getattr(law, name)) > largest:
            raise ConfigurationError(
                f"{name} = {given:g} is unstable at {1.0 / tick:g} Hz for this hand; at most "
                f"{largest:.2g}, and half of that or less where commands are late"
            )


def _check_posture(hand: Hand, theta: Array) -> None:
    """Reject an initial posture beyond the limits of a joint."""
    lower, upper = hand.position_limits
    beyond = np.flatnonzero((theta < lower) | (theta > upper))
    if len(beyond):
        i = int(beyond[0])
        raise ConfigurationError(
            f"initial_joints = {theta[i]:.3g} rad of {hand.joint_names[i]} is beyond its limits,"
            f" {lower[i]:.3g} to {upper[i]:.3g} rad; close the hand within them"
        )


def _check_mode(scenario: Scenario) -> None:
    """Reject laws that need what the skin does not measure, and pose targets of a grip.

    Also reject slip prevention with the baselines (8) and (10): they press toward the centroid with
    k_f times a distance, so the newtons required by the regulator would be misread as newtons per
    meter.
    """
    law, mode = scenario.manipulation_controller.law, scenario.slip_regulator.mode
    name = law.name
    if scenario.tactile_sensor.axes == "normal" and name != "grip":
        raise ConfigurationError(
            f"the law '{name}' and its slip prevention need forces in three axes, but "
            "tactile_sensor.axes is normal; set manipulation_controller.law.name to grip"
        )
    if name == "grip" and scenario.targets:
        raise PoseError(NO_POSES)
    if name in LAWS and not law.uses_optimal_forces and mode != "user":
        raise ConfigurationError(
            f"the law '{name}' multiplies the grasp force by a distance, so slip prevention "
            f"would apply a different force than it computes; set slip_regulator.mode to user "
            f"instead of {mode}, or the law to optimal"
        )


def _check_own_law(config: LawConfig, hand: Hand, seen: LawInput) -> None:
    """Call a user law once for its torques, before it holds anything."""
    try:
        law = law_of(config)(config, hand.radii)
        law.seen = seen
        answers = {
            "internal_torque()": law.internal_torque(),
            "drive(wrench)": law.drive(np.full(6, 0.1)),
        }
    except TactileHandError:
        raise
    except Exception as error:
        raise ConfigurationError(
            f"the law '{config.name}' fails at the first tick with {type(error).__name__}: {error}"
        ) from error
    for name, torque in answers.items():
        is_torque = isinstance(torque, np.ndarray) and torque.shape == (hand.joints,)
        if not is_torque or not np.isfinite(torque).all():
            raise ConfigurationError(
                f"the law '{config.name}' returns {str(torque)[:60]} from {name}; expected an "
                f"array of {hand.joints} finite torques, one per joint [N m]"
            )
