# SPDX-License-Identifier: Apache-2.0
"""The law `grip` in the controller: forces, posture, load, and what it and other laws reject."""

import numpy as np
import pytest
from support.controllers import REST, Bench
from support.equations import grasp_map, hand_jacobian

from tactile_hand_ros.control.contact import in_palm, joint_torques
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.stability import kept_contacts
from tactile_hand_ros.errors import PoseError

AWAY = np.array([0.01, -0.02, 0.015, 0.0, 0.01, -0.01, 0.02, 0.0, -0.015])  # rad


def gripping(**values):
    return Bench(law__name="grip", law__k_p=0.0, law__k_o=0.0, law__damping=0.0, **values)


def normal(bench, missing=0.0):
    """Return k_f f* as a skin for normal forces measures it, less N at the second finger."""
    forces = np.full((3, 3), np.nan)
    forces[:, 1] = bench.grasp_force * bench.optimal[:, 1]
    forces[1, 1] -= missing
    return forces


def pressing(bench, grasp_force, theta):
    """Return the torques of an internal force, shape (9,), N m; the contacts move with the tips."""
    hand, touch = bench.controller.hand, bench.contacts
    tips, moved = hand.fingertips(theta), theta - bench.theta
    before = tips._replace(positions=tips.positions - tips.linear @ moved)
    positions, frames = carried_along(before, touch.positions, touch.rotations, moved)
    forces = in_palm(frames, bench.optimal, grasp_force)
    return joint_torques(tips, positions, forces)


def test_it_presses_from_its_posture_which_a_hold_keeps():
    bench = gripping()
    bench.step(3, forces=normal(bench))
    theta = bench.theta + AWAY
    wanted = pressing(bench, 10.0, theta) - bench.stiffness(theta) @ AWAY
    driven = bench.step(forces=normal(bench), theta=theta)
    np.testing.assert_allclose(driven.torque, wanted, atol=1e-9)
    held = bench.step(theta=theta, contacts=bench.nowhere)
    assert (driven.mode, held.mode) == (Mode.DRIVE, Mode.HOLD)
    np.testing.assert_allclose(held.torque, wanted, atol=1e-9)
    again = bench.step(forces=normal(bench), theta=theta)
    np.testing.assert_allclose(again.torque, wanted, atol=1e-9)


@pytest.mark.parametrize(("limit", "crush", "most"), [(5.0, 0.0, 5.0), (5.0, 12.0, 2.0)])
def test_it_presses_harder_until_no_finger_lacks_its_part(limit, crush, most):
    bench = gripping(law__integral__force_limit=limit, grasp_force_limit=crush)
    bench.step(2, forces=normal(bench))
    ratio = 0.4 / bench.optimal[1, 1]
    found = bench.step(forces=normal(bench, 0.4)).torque
    rise = 0.25 / (0.015 + 3.5 * 0.002) * 0.002 * ratio
    np.testing.assert_allclose(found, pressing(bench, 10.0 + rise, bench.theta), atol=1e-9)
    bench.controller.joints_held = True  # what the guard does is not its own
    np.testing.assert_array_equal(bench.step(100, forces=normal(bench, 0.4)).torque, found)
    bench.controller.joints_held = False
    found = bench.step(1000, forces=normal(bench, 0.4)).torque
    np.testing.assert_allclose(found, pressing(bench, 10.0 + most, bench.theta), atol=1e-9)


def test_it_waits_while_a_finger_is_not_felt():
    bench = gripping()
    bench.step(2, forces=normal(bench))
    unfelt = {"forces": normal(bench, 0.4), "contacts": bench.without_finger(2)}
    found = bench.step(100, **unfelt)
    assert found.mode is Mode.DRIVE
    np.testing.assert_allclose(found.torque, pressing(bench, 10.0, bench.theta), atol=1e-9)


def test_its_integral_carries_a_load_by_motions_that_keep_the_contacts():
    bench = gripping(law__integral__time=0.1, law__integral__torque_limit=10.0)
    hand = bench.controller.hand
    free = kept_contacts(hand, bench.theta, bench.contacts)
    jacobian = hand_jacobian(*hand.fingertips(bench.theta), bench.contacts.positions)
    twists = grasp_map(bench.contacts.positions, bench.centroid).T
    moved = np.linalg.lstsq(twists, jacobian @ free, rcond=None)[0]
    np.testing.assert_allclose(twists @ moved, jacobian @ free, atol=1e-12)
    assert np.linalg.matrix_rank(free) == 6
    bench.step(3, forces=normal(bench))
    theta = bench.theta + AWAY
    once = bench.step(forces=normal(bench), theta=theta).torque
    found = bench.step(50, forces=normal(bench), theta=theta).torque - once
    np.testing.assert_allclose(found, -free @ bench.stiffness(theta) @ free @ AWAY, atol=1e-9)
    most = bench.step(2000, forces=normal(bench), theta=theta)
    spring = pressing(bench, 10.0, theta) - bench.stiffness(theta) @ AWAY
    assert np.abs(most.torque - spring).max() == pytest.approx(10.0)
    held = bench.step(theta=theta, contacts=bench.nowhere).torque
    np.testing.assert_allclose(held, most.torque, atol=1e-9)


def test_it_rejects_poses_and_a_law_that_needs_three_axes_holds_without_them():
    bench = gripping()
    bench.step(forces=normal(bench))
    with pytest.raises(PoseError, match="normal forces do not show a load; use the law optimal"):
        bench.controller.targets.command(bench.target(0.01, 0.0, 0.0))
    bench = Bench(law__observer__time=0.1)
    command = bench.step(2, forces=normal(bench), applied=REST)
    assert command.mode is Mode.HOLD and "tangential forces" in command.reason
    assert Bench().step(2, forces=normal(bench)).mode is Mode.DRIVE  # it needs no forces
