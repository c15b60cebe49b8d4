# SPDX-License-Identifier: Apache-2.0
"""The formulas of the audit, each against its definition; on whole runs see test_recompute."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.verify import audit_forces, audit_torques, recompute
from tactile_hand_ros.verify.checks import Check, check, merged, rows
from tactile_hand_ros.verify.recompute import Comparison, Recomputation
from tactile_hand_ros.verify.recorded_inputs import Effect, Inputs, Request
from tactile_hand_ros.verify.shapes import grasp_maps, rotations, spread

Array = NDArray[np.float64]

RANDOM = np.random.default_rng(5)
POSITIONS = RANDOM.normal(size=(4, 3, 3))
TURNS = [Rotation.random(3, random_state=seed) for seed in range(4)]
ROTATIONS = np.array([turn.as_matrix() for turn in TURNS])


def record_of(ticks: int) -> Record:
    record = Record.empty(ticks, ["a", "b", "c"], ["j"])
    record.stamps[:] = 2_000_000 * np.arange(ticks)
    return record


def test_a_check_counts_what_deviates_more_than_allowed_and_what_is_no_number() -> None:
    record, rows = record_of(9), np.array([1, 3, 4, 6, 8])
    found = check("c", record, rows, np.array([0.1, 0.5, 0.51, 0.2, np.nan]), 0.5, "m")
    assert (found.name, found.ticks, found.tolerance, found.unit) == ("c", 5, 0.5, "m")
    assert (found.first, found.wrong, found.ok) == (8_000_000, 2, False)
    assert np.isnan(found.worst)
    good = check("c", record, rows, np.array([0.1, 0.5, 0.3, 0.2, 0.0]), 0.5, "m")
    assert (good.first, good.wrong, good.worst, good.ok) == (None, 0, 0.5, True)
    none = check("c", record, rows[:0], np.zeros(0), 0.5, "m")
    assert (none.ticks, none.worst, none.first, none.ok) == (0, 0.0, None, True)


def test_checks_of_one_name_are_joined() -> None:
    checks = [
        Check("a", 3, 0.2, 1.0, "m", 40, 2),
        Check("b", 1, 0.0, 1.0, "m", None, 0),
        Check("a", 4, 0.5, 1.0, "m", 30, 1),
        Check("a", 5, 0.1, 1.0, "m", None, 0),
    ]
    assert merged(checks) == [Check("a", 12, 0.5, 1.0, "m", 30, 3), checks[1]]
    unknown = [Check("a", 1, np.nan, 1.0, "m", 5, 1), Check("a", 1, 0.3, 1.0, "m", None, 0)]
    for pair in (unknown, unknown[::-1]):
        [found] = merged(pair)
        assert np.isnan(found.worst) and (found.first, found.wrong) == (5, 1)


def test_checks_and_comparisons_as_text() -> None:
    assert rows([Check("a", 12, 0.123, 1e-6, "m", 1_500_000_000, 3)]) == [
        ["a", "12", "0.12 m", "1e-06", "3", "1.500 s"]
    ]
    assert rows([Check("a", 12, 0.0, 0.5, "1", None, 0)])[0][4:] == ["none", ""]
    comparisons = [
        Comparison("t", "N", 9, 9, None, 0.0),
        Comparison("t", "N", 9, 7, 1_500_000_000, 0.12345),
        Comparison("t", "N", 9, 8, 0, np.nan),
        Comparison("t", "bytes", 9, 8, 0, np.nan),
    ]
    assert [row[3:] for row in recompute.rows(comparisons)] == [
        ["", "none"],
        ["1.500 s", "0.123 N"],
        ["0.000 s", "only one has an answer"],
        ["0.000 s", "other bytes"],
    ]
    assert recompute.rows(comparisons)[1][:3] == ["t", "9", "7"]


def test_answers_are_the_same_where_all_bits_are_and_nan_is_nan() -> None:
    nan = np.nan
    stamps = np.arange(6) * 10
    one = np.array([[1.0, nan], [nan, nan], [0.0, 2.0], [3.0, nan], [4.0, 5.0], [1.0, 1.0]])
    other = np.array([[1.0, nan], [nan, nan], [-0.0, 2.0], [3.0, 1.0], [4.0, 5.5], [1.0, 1.0]])
    found = recompute._compare("t", "N", stamps, one, other)
    assert (found.compared, found.identical, found.first, found.largest) == (5, 2, 20, 0.5)
    same = recompute._compare("t", "N", stamps, one, one)
    assert same.same and (same.compared, same.first, same.largest) == (5, None, 0.0)
    [only] = [recompute._compare("t", "N", stamps[:1], one[1:2], one[:1])]
    assert (only.compared, only.identical) == (1, 0) and np.isnan(only.largest)


def test_a_recomputation_is_as_fast_as_its_time_says() -> None:
    good, bad = Comparison("t", "N", 9, 9, None, 0.0), Comparison("u", "N", 9, 8, 0, 1.0)
    made: Any = Recomputation(record_of(1), [good, bad], SimpleNamespace(), 3.0, 0.5)  # type: ignore[arg-type]
    assert made.speed == 6.0 and not made.same
    made = Recomputation(record_of(1), [good], SimpleNamespace(), 3.0, 0.0)  # type: ignore[arg-type]
    assert made.speed == np.inf and made.same


def test_a_run_that_is_not_reproduced_has_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recompute, "versions", lambda: {"numpy": "2.0", "scipy": "1.0"})

    def reason(**told: str) -> str:
        return recompute.reason(SimpleNamespace(summary=SimpleNamespace(custom_data=told)))  # type: ignore[arg-type]

    assert reason(version_numpy="1.9", version_scipy="1.0", lost_messages="3") == (
        ": numpy 1.9 then, 2.0 now."
    )
    both = reason(version_numpy="1.9", version_scipy="0.9")
    assert both == ": numpy 1.9 then, 2.0 now; scipy 0.9 then, 1.0 now."
    assert reason(lost_messages="3") == ": 3 messages are missing from the bag."
    for told in ({}, {"lost_messages": "0"}):
        assert reason(**told).startswith("; changed code, or a node that was started again")


def test_rotations_are_those_of_quaternions_of_any_length() -> None:
    quaternions = np.array([[3.0 * turn.as_quat()[i] for i in range(3)] for turn in TURNS])
    np.testing.assert_allclose(rotations(quaternions), ROTATIONS, atol=1e-14)


def test_the_spread_is_the_ratio_of_the_two_largest_extents() -> None:
    turned = TURNS[0][0].apply([[3.0, 0.0, 0.0], [-1.5, 1.0, 0.0], [-1.5, -1.0, 0.0]])
    moments = np.array([3.0**2 + 2 * 1.5**2, 2.0])
    [found] = spread(np.array([turned + [1.0, 2.0, 3.0]]))
    assert found == pytest.approx(np.sqrt(moments[1] / moments[0]))


def test_fingers_grasp_where_all_touch_and_not_on_a_line() -> None:
    record = record_of(4)
    record.contact_positions[:] = [[0.1, 0.0, 0.0], [-0.05, 0.05, 0.0], [-0.05, -0.05, 0.0]]
    record.contact_positions[1, 2] = np.nan
    # The spread is 2 / sqrt(3) times this share of the length.
    for tick, share in ((2, 1.01e-3), (3, 0.99e-3)):
        width = 0.5 * np.sqrt(3.0) * share * 0.1
        record.contact_positions[tick, 1:, 1] = width, -width
    assert spread(record.contact_positions[2:]) == pytest.approx([1.01e-3, 0.99e-3])
    assert audit_forces.grasped(record).tolist() == [True, False, True, False]


def test_the_grasp_map_adds_forces_and_their_torques_about_the_centroid() -> None:
    forces = RANDOM.normal(size=(4, 3, 3))
    wrench = (grasp_maps(POSITIONS) @ forces.reshape(4, 9, 1))[:, :, 0]
    arms = POSITIONS - POSITIONS.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(wrench[:, :3], forces.sum(axis=1))
    np.testing.assert_allclose(wrench[:, 3:], np.cross(arms, forces).sum(axis=1))


def test_the_load_is_the_smallest_with_the_same_wrench_and_the_rest_is_the_squeeze() -> None:
    forces = RANDOM.normal(size=(4, 3, 3))
    load, squeeze = audit_forces._loads(POSITIONS, ROTATIONS, forces)
    for i in range(4):
        palm = np.array([TURNS[i][j].apply(forces[i, j]) for j in range(3)])
        grasp_map = grasp_maps(POSITIONS[i : i + 1])[0]
        least = np.linalg.lstsq(grasp_map, grasp_map @ palm.ravel(), rcond=None)[0].reshape(3, 3)
        expected = np.array([TURNS[i][j].inv().apply(least[j]) for j in range(3)])
        np.testing.assert_allclose(load[i], expected, atol=1e-12)
        assert squeeze[i] == pytest.approx((forces[i] - expected)[:, 1].sum())


def test_a_reserve_is_its_floor_over_all_fingers_or_its_share_of_the_largest_load() -> None:
    config = ForceOptimizerConfig().changed({"reserve.floor": 3.0, "reserve.share": 0.5})
    worst, friction = np.arange(36.0).reshape(3, 12), np.array([0.5, 0.8, 2.0])
    found = audit_forces._with_reserve(config, worst, np.array([0.1, 2.0, 6.0]), friction)
    # A ball of this radius touches a side whose normal has the length hypot(1, 1 / friction).
    radii = np.array([1.0, 1.0, 3.0])
    added = np.cos(np.pi / 12) * friction * radii * np.sqrt(1.0 + 1.0 / friction**2)
    np.testing.assert_allclose(found, worst + added[:, None])


@pytest.mark.parametrize(
    ("squeeze", "rest", "borne"),
    [
        ([1.0, -2.0, 0.5], [0.5, -0.5, 0.0], [1.0, -2.0, 0.5]),
        ([4.0, -2.0, 0.5], [1.0, -0.5, 0.0], [2.0, -1.0, 0.25]),  # joint 0 bears half
        ([4.0, -4.0, 0.5], [1.0, -2.0, 0.0], [1.0, -1.0, 0.125]),  # joint 1 a quarter
        ([4.0, 1.0, 0.5], [5.0, 0.0, 0.0], [0.0, 0.0, 0.0]),  # the rest alone is too much
        ([0.0, 1.0, 0.5], [5.0, 0.0, 0.0], [0.0, 1.0, 0.5]),  # but not because of the squeeze
        ([2.0, 1.0, 0.5], [1.0, 2.0, 0.0], [2.0, 1.0, 0.5]),  # just at its limit
    ],
)
def test_a_squeeze_is_borne_as_far_as_every_joint_keeps_its_limit(
    squeeze: list[float], rest: list[float], borne: list[float]
) -> None:
    found = audit_torques._borne(np.array(squeeze), np.array(rest), np.full(3, 3.0))
    np.testing.assert_allclose(found, borne)


def test_an_integral_grows_in_each_half_up_to_its_own_limit() -> None:
    def config(**changes: float) -> ControllerConfig:
        values = {"k_p": 2.0, "k_o": 3.0, "force_limit": 1.0, "torque_limit": 0.75} | changes
        return ControllerConfig().changed({f"law.integral.{k}": v for k, v in values.items()})

    error = np.array([0.1, 0.2, -0.2, 0.3, 0.0, -0.4])
    before = np.array([0.1, 0.0, 0.2, -0.1, 0.1, 0.0])
    grown = audit_torques._integrated(config(), before, error, 0.5)
    np.testing.assert_allclose(grown, before + error * [1.0, 1.0, 1.0, 1.5, 1.5, 1.5])
    far = audit_torques._integrated(config(), before, error, 5.0)
    for half, gain, limit in ((slice(0, 3), 2.0, 1.0), (slice(3, 6), 3.0, 0.75)):
        free = before[half] + 5.0 * gain * error[half]
        np.testing.assert_allclose(far[half], limit * free / np.linalg.norm(free))
    off = audit_torques._integrated(config(k_p=0.0), before, error, 0.5)
    np.testing.assert_allclose(off, [0.0, 0.0, 0.0, *grown[3:]])
    off = audit_torques._integrated(config(k_o=0.0), before, error, 0.5)
    np.testing.assert_allclose(off, [*grown[:3], 0.0, 0.0, 0.0])
    none = audit_torques._integrated(config(), np.zeros(6), np.zeros(6), 0.5)
    np.testing.assert_array_equal(none, np.zeros(6))


def test_the_virtual_frame_points_along_the_first_two_contacts_either_side_up() -> None:
    """Its x lies along the line between them, its z is normal to the plane of all three."""
    along = POSITIONS[:, 0] - POSITIONS[:, 1]
    normal = np.cross(along, POSITIONS[:, 0] - POSITIONS[:, 2])
    x = along / np.linalg.norm(along, axis=1)[:, None]
    z = normal / np.linalg.norm(normal, axis=1)[:, None]
    z[::2] *= -1.0
    frames = np.stack([x, np.cross(z, x), z], axis=2)
    for tilt in ([0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.01]):
        turned = Rotation.from_matrix(frames) * Rotation.from_rotvec(tilt)
        off = audit_torques._frame_errors(POSITIONS, turned.as_quat())
        moved = np.abs(turned.as_matrix() - frames)
        expected = np.maximum(moved[:, :, 0].max(axis=1), moved[:, :, 2].max(axis=1))
        np.testing.assert_allclose(off, expected, atol=1e-14)
        assert (max(tilt) == 0.0) == (off.max() < 1e-12)


def inputs(answered: list[bool], requests: list[Effect], may_skip: bool = True) -> Inputs:
    record = record_of(len(answered))
    record.command[answered] = 0.0
    felt = np.ones(len(answered), dtype=np.bool_)
    called = {"manipulation_controller": requests}
    return Inputs(record, [None] * len(felt), felt, {}, requests=called, may_skip=may_skip)


def test_ticks_that_the_controller_skipped_do_not_count_as_its_turns() -> None:
    answered = [True, True, False, True, False, True]
    assert audit_torques._turns(inputs(answered, [])).tolist() == [0, 1, 1, 2, 2, 3]
    assert audit_torques._turns(inputs(answered, [], may_skip=False)).tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("request_", "stamp", "expected"),
    [
        (Request("reset", False), 4_000_000, [0, 1, 0, 0]),
        (Request("reset", False), 5_000_000, [0, 0, 1, 0]),
        (Request("grasp", False), 0, [1, 0, 0, 0]),
        (Request("grasp", False), 9_000_000, [0, 0, 0, 1]),
        (Request("grasp", False), 11_000_000, [0, 0, 0, 0]),
        (Request("grasp", True), 4_000_000, [0, 0, 0, 0]),
        (Request("enable", False), 4_000_000, [0, 0, 0, 0]),
    ],
)
def test_a_reset_and_an_opened_hand_begin_a_new_grasp(
    request_: Request, stamp: int, expected: list[int]
) -> None:
    given = inputs([True] * 6, [Effect(stamp, request_)])
    found = audit_torques._renewed(given, np.array([1, 2, 4, 5]))
    assert found.astype(int).tolist() == expected
