# SPDX-License-Identifier: Apache-2.0
"""Audit: does every recorded f* follow from the optimum of (13), every torque from the law?

Both are computed again from the recorded inputs, by other formulas and solvers than those of the
nodes. What they share with the nodes is the hand's kinematics, and the small filters that have a
memory: reference and load observer. Grasp map and hand Jacobian are independent on purpose: a
mistake in those that the nodes run would otherwise be made twice and look right. Poses, live gains
and calls of `~/reset` and `~/grasp` count from the ticks at which the nodes published that they
took effect.

Where the hand did not drive, torques are not checked.
"""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify.audit_forces import audit_absence, audit_forces, grasped
from tactile_hand_ros.verify.audit_torques import audit_torques
from tactile_hand_ros.verify.checks import Check
from tactile_hand_ros.verify.recompute import scenario_of
from tactile_hand_ros.verify.recorded_inputs import read_inputs


def audit(run: Run) -> list[Check]:
    """Audit a run whose scenario is known.

    Raises:
        BagError: If it is not known, the bag cannot be read, or the hand never had a grasp.
    """
    scenario = scenario_of(run)
    inputs = read_inputs(run, scenario)
    if not grasped(inputs.record).any():
        raise BagError(
            f"{run.bag} has no tick at which all fingers touch, expected one: there is nothing to "
            "audit; record a run with a grasp."
        )
    hand = Hand.load(
        scenario.hand, scenario.layout, np.array(scenario.manipulation_controller.gravity)
    )
    return [*audit_forces(inputs), audit_absence(inputs), *audit_torques(hand, inputs)]
