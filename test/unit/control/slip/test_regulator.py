# SPDX-License-Identifier: Apache-2.0
"""The user's grasp force: within limits and without jumps."""

import numpy as np
import pytest
from support.grasps import balance_in_frames, contacts_at, moved, three_faces
from support.plants import plant

from studies.invariance import orientations
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import in_palm
from tactile_hand_ros.control.loads import split
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.errors import ConfigurationError, MessageError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.scenario.scenario import load_scenario

UNKNOWN, STICK, SLIP = ContactState.UNKNOWN, ContactState.STICK, ContactState.SLIP
TICK = 2_000_000
WEIGHT = 4.905  # of a finger of the paper's hand, N
ALL = np.ones(3, dtype=bool)
NO_TOUCH = three_faces().without(ALL), np.zeros((3, 3))
STILL = Joints(np.zeros(9), np.zeros(9))  # and unknown torques
NO_RESERVE = {"floor": 0.0, "fraction": 0.0}
ON_A_LINE = np.array([[0.0, 2.0, 0.0], [0.0, 2.0, 0.0], [0.0, 4.0, 0.0]])  # forces, N


def regulator(**values):
    return SlipRegulator(SlipRegulatorConfig(**values))


def grasp_forces(slip, ticks, *seen, start=0):
    """Return k_f at each of the ticks, at which the same contacts and forces are seen."""
    stamps = range(TICK * start, TICK * (start + ticks), TICK)
    return np.array([slip.step(stamp, STILL, *(seen or NO_TOUCH)) for stamp in stamps])


def test_rises_and_falls_at_its_rates_and_lands_exactly_on_the_goal():
    slip = regulator(grasp_force=5.0, rise_rate=50.0, fall_rate=20.0)
    slip.step(0, STILL, *NO_TOUCH)
    slip.request(20.0)
    up = grasp_forces(slip, 1000, start=1)
    slip.request(5.0)
    down = grasp_forces(slip, 2000, start=1001)
    for force, goal, rate in ((up, 20.0, 50.0), (down, 5.0, 20.0)):
        steps = np.abs(np.diff(force))
        assert steps.max() == pytest.approx(rate * 0.002)
        assert (np.diff(np.abs(force - goal)) <= 0.0).all()  # no overshoot, no reversal
        assert force[-1] == pytest.approx(goal, abs=1e-6)
    # 12.5 N at full rate, then exponentially with the time constant.
    assert up[125] == pytest.approx(5.0 + 0.252 * 50.0, abs=1e-9)
    landing = 20.0 - up[300:400]
    np.testing.assert_allclose(landing[1:] / landing[:-1], 1.0 - 0.002 / 0.05, rtol=1e-3)
    slip.request(15.0)
    # A long silence lands on the goal, not beyond.
    assert slip.step(10**12, STILL, *NO_TOUCH) == 15.0


@pytest.mark.parametrize("force", [0.4, 41.0, -1.0, float("nan"), float("inf")])
def test_what_is_outside_the_limits_is_refused_and_changes_nothing(force):
    slip = regulator(grasp_force=10.0, minimum=0.5, maximum=40.0)
    slip.step(0, STILL, *NO_TOUCH)
    with pytest.raises(MessageError, match=r"outside 0.5 to 40.0 N"):
        slip.request(force)
    np.testing.assert_array_equal(grasp_forces(slip, 10, start=1), 10.0)
    for limit in (0.5, 40.0):
        slip.request(limit)
    assert grasp_forces(slip, 3000, start=11)[-1] == pytest.approx(40.0, abs=1e-6)


def test_a_clock_that_starts_again_makes_no_jump():
    slip = regulator()
    grasp_forces(slip, 10, start=1000)
    slip.request(20.0)
    before = slip.grasp_force
    assert abs(slip.step(0, STILL, *NO_TOUCH) - before) <= 50.0 * 0.002
    assert grasp_forces(slip, 2000, start=1)[-1] == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("asked", "limits", "bound"), [(30.0, {"maximum": 15.0}, 15.0), (6.0, {"minimum": 9.0}, 9.0)]
)
def test_a_new_limit_takes_hold_at_once_and_leaves_no_jump_for_when_it_is_lifted(
    asked, limits, bound
):
    slip = regulator(grasp_force=10.0)
    slip.step(0, STILL, *NO_TOUCH)
    slip.request(asked)
    assert grasp_forces(slip, 1500, start=1)[-1] == pytest.approx(asked)
    slip.configure(SlipRegulatorConfig(**limits))
    np.testing.assert_array_equal(grasp_forces(slip, 20, start=1501), bound)
    slip.configure(SlipRegulatorConfig())
    lifted = np.array([bound, *grasp_forces(slip, 1500, start=1521)])
    assert np.diff(lifted).max() <= 50.0 * 0.002 + 1e-12
    assert np.diff(lifted).min() >= -20.0 * 0.002 - 1e-12
    assert lifted[-1] == pytest.approx(asked)


def test_the_minimum_holds_for_what_the_object_needs_too():
    light = np.array([[0.0, 0.5, 0.05], [0.0, 0.5, 0.05], [0.0, 0.1, 0.0]])
    slip = regulator(mode="auto", minimum=2.0, maximum=8.0, grasp_force=8.0, reserve=NO_RESERVE)
    found = grasp_forces(slip, 2000, three_faces(), light)
    assert 0.0 < slip.needed < 1.5 and found.min() == found[-1] == 2.0


FORCES = np.array([[0.4, 2.6, 1.8], [-0.3, 2.2, 0.9], [0.2, 1.1, 0.3]])


def run(slip, ticks, slides=(), contacts=None, forces=FORCES, seed=0):
    """Return all outputs at ticks 2 ms apart, while some fingers slide."""
    told, random = [], np.random.default_rng(seed)
    rms = np.array([0.15 if finger in slides else 0.005 for finger in range(3)])[:, None]
    for i in range(ticks):
        now = forces + rms * random.standard_normal((3, 3))
        force = slip.step(i * TICK, STILL, contacts or three_faces(), now)
        likelihood = slip.slip_likelihood
        told.append([force, slip.needed, *slip.learned_friction, *slip.state, *likelihood])
    return np.array(told)


@pytest.mark.parametrize("slides", [(), (1,)])
def test_a_regulator_that_was_reset_equals_a_new_one(slides):
    fresh, used = (regulator(mode="shared", grasp_force=8.0) for _ in range(2))
    used.request(30.0)
    run(used, 150, seed=1)
    run(used, 15, slides=(0, 2), seed=2)
    assert (used.learned_friction != fresh.learned_friction).all() and used.grasp_force > 8.0
    assert SLIP in used.state and used.slip_likelihood.max() == 1.0
    used.reset()
    np.testing.assert_array_equal(used.learned_friction, [0.4, 0.4, 0.4])
    assert (used.state == UNKNOWN).all() and not used.slip_likelihood.any()
    assert np.isnan(used.needed) and used.grasp_force == 8.0
    np.testing.assert_array_equal(run(used, 150, slides), run(fresh, 150, slides))


def parted(finger):
    """Return contacts with one missing."""
    return three_faces().without(np.arange(3) == finger)


@pytest.mark.parametrize("mode", ["user", "auto"])
@pytest.mark.parametrize("lost", [0, 1])
def test_a_finger_without_a_contact_tells_nothing_whatever_force_it_reports(mode, lost):
    """A skin with drift may report a force; here it would imply a friction of 0.7 and more."""
    slip = regulator(mode=mode)
    run(slip, 200, contacts=parted(lost))
    known = np.hypot(FORCES[:, 0], FORCES[:, 2]) / FORCES[:, 1] > 0.45
    for finger in range(3):
        assert slip.state[finger] == (UNKNOWN if finger == lost else STICK)
        assert (slip.learned_friction[finger] > 0.45) == (known[finger] and finger != lost)
    assert slip.learned_friction[lost] == 0.4
    assert np.isnan(slip.needed)


def test_a_start_outside_the_limits_is_refused():
    with pytest.raises(ConfigurationError, match="grasp_force = 50.0 N is outside"):
        SlipRegulatorConfig().changed({"grasp_force": 50.0})
    with pytest.raises(ConfigurationError, match="outside minimum = 12.0 N"):
        SlipRegulatorConfig().changed({"minimum": 12.0})


def test_a_change_of_mode_makes_no_jump():
    contacts, forces = plant().state.contacts, np.array([[0.5, 2.0, 0.8]] * 3)
    slip = regulator(mode="auto", grasp_force=6.0, reserve=NO_RESERVE)

    def change(mode, at, ticks):
        slip.configure(SlipRegulatorConfig(mode=mode, grasp_force=6.0, reserve=NO_RESERVE))
        return np.array([slip.grasp_force, *grasp_forces(slip, ticks, contacts, forces, start=at)])

    needed = change("auto", 0, 500)[-1]
    assert needed > 7.0
    down = change("user", 500, 1000)
    assert down[0] == needed and np.diff(down).min() >= -20.0 * 0.002 - 1e-9
    assert down[-1] == pytest.approx(6.0, abs=1e-6)
    slip.request(30.0)
    assert change("auto", 1500, 500)[-1] <= needed  # the user's request does not count there
    up = change("shared", 2000, 1000)
    assert np.diff(up).max() <= 50.0 * 0.002 + 1e-9 and up[-1] == pytest.approx(30.0, abs=1e-6)


@pytest.mark.parametrize("finger", range(3))
def test_with_a_contact_lost_the_grasp_force_doubles_and_never_falls(finger):
    slip = regulator(mode="auto", grasp_force=4.0, reserve=NO_RESERVE)
    forces = np.array([[0.0, 2.0, 0.1], [0.0, 2.0, 0.1], [0.0, 0.5, 0.0]])
    held = grasp_forces(slip, 100, three_faces(), forces)[-1]
    left = np.array([[0.0, 2.0, 0.1]] * 3)
    found = grasp_forces(slip, 500, parted(finger), left, start=100)
    assert found[5] >= 2.0 * held - 1e-9 and (np.diff(found) >= 0.0).all()


@pytest.mark.parametrize("lasts", [5, 40])
def test_a_contact_that_fails_to_report_is_no_load_however_long_k_f_follows(lasts):
    """The other forces stay proportional to k_f, as in a grasp without load."""
    slip, k_f = regulator(mode="auto", maximum=400.0), 10.0
    shape = FORCES / FORCES[:, 1].sum()
    for tick in range(1000 + lasts):
        noise = 1e-3 * np.sin(tick + np.arange(9.0)).reshape(3, 3)
        seen = three_faces() if tick < 1000 else parted(1)
        if tick == 1000:
            before = k_f
        forces = np.where(seen.touching[:, None], k_f * shape + noise, 0.0)
        k_f = slip.step(tick * 1_000_000, STILL, seen, forces)
    assert k_f <= 2.2 * before


def test_the_load_that_has_torn_a_contact_off_is_carried_by_the_others_and_counts():
    """As if the contact were still there without a force; k_f follows within three ticks."""
    slip = regulator(mode="auto", grasp_force=4.0, maximum=200.0, reserve=NO_RESERVE)
    run(slip, 300)
    torn = FORCES + np.array([[0.0, 1.0, 3.0], [0.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    torn[2] = 0.0
    found = grasp_forces(slip, 3, parted(2), torn, start=300)[-1]
    assert min(found, slip.needed) > 20.0  # and it rises by 8 N a tick
    again = regulator(mode="auto", grasp_force=4.0, maximum=200.0, reserve=NO_RESERVE)
    again.step(0, STILL, parted(2), torn)  # never complete: the grasp is unknown
    assert np.isnan(again.needed)


def carried(slip, contacts, forces, at=1000):
    slip.step(at * TICK, STILL, contacts, forces)
    return slip.carried


def thin(margin):
    """Return nearly collinear contacts; height h over the line gives a margin of h / sqrt(3)."""
    height = margin * np.sqrt(3.0)
    points = 0.1 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, height, 0.0]])
    return contacts_at(points, [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.mark.parametrize("mode", ["user", "auto"])
def test_what_is_carried_is_the_load_in_contact_frames_usable_friction_and_a_reserve(mode):
    """The load is expressed by the pseudoinverse of G~ in contact frames."""
    grasp = moved(three_faces(), rotation_from_vector([0.4, -1.1, 0.7]), np.array([0.1, 0.0, 0.3]))
    slip = regulator(mode=mode, reserve={"fraction": 0.5}, reflex={"margin": 0.25})
    found, balance = carried(slip, grasp, FORCES), balance_in_frames(grasp)
    expected = (np.linalg.pinv(balance) @ balance @ FORCES.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(found.load, expected, atol=1e-12)
    np.testing.assert_allclose(found.friction, slip.learned_friction / 1.25)
    largest = 0.5 * np.linalg.norm(expected, axis=1)
    np.testing.assert_allclose(found.reserve, np.maximum(0.6 * WEIGHT / 3.0, largest))


@pytest.mark.parametrize(
    ("contacts", "forces", "rejected"),
    [
        (three_faces(), -FORCES, ~ALL),
        (thin(0.0099), ON_A_LINE, ~ALL),
        (three_faces().without(ALL), FORCES, ~ALL),
        (three_faces(), FORCES, ALL),
    ],
    ids=["fingers pull", "contacts on a line", "none touches", "touch is rejected"],
)
def test_without_a_grasp_there_is_no_load_and_the_next_starts_afresh(contacts, forces, rejected):
    slip = regulator(mode="auto")
    run(slip, 300, forces=3.0 * FORCES)
    slip.reject_touch(rejected)
    assert np.isnan(carried(slip, contacts, forces).load).all() and np.isnan(slip.needed)
    slip.reject_touch(~ALL)
    found = carried(slip, three_faces(), FORCES, at=1001).load
    np.testing.assert_allclose(found, carried(regulator(), three_faces(), FORCES).load, atol=1e-12)


def test_a_grasp_a_hundredth_as_thin_as_long_carries_something():
    assert np.isfinite(carried(regulator(), thin(0.0101), ON_A_LINE).load).all()


@pytest.mark.parametrize("finger", range(3))
def test_the_rejected_touch_of_one_finger_counts_as_none(finger):
    unfelt = np.arange(3) == finger
    rejecting, without = regulator(mode="auto"), regulator(mode="auto")
    for slip in (rejecting, without):
        run(slip, 300, forces=3.0 * FORCES)
    rejecting.reject_touch(unfelt)
    for i in range(300, 600):
        wrong = np.where(unfelt[:, None], 9.0 * np.sin(i), 3.0 * FORCES)
        before = rejecting.grasp_force
        assert rejecting.step(i * TICK, STILL, three_faces(), wrong) >= before > 10.0
        blank = np.where(unfelt[:, None], 0.0, 3.0 * FORCES)
        without.step(i * TICK, STILL, three_faces().without(unfelt), blank)
        assert rejecting.needed == pytest.approx(without.needed, rel=0.01)
        learned = rejecting.learned_friction, without.learned_friction
        np.testing.assert_allclose(*learned, rtol=0.01)  # that of the last 40 ms is forgotten


def test_friction_is_kept_while_nothing_touches_but_a_rejected_finger():
    """Only an object that is gone may be another one now."""
    slip = regulator(mode="auto")
    run(slip, 300, slides=(0, 1), forces=3.0 * FORCES)
    learned = slip.learned_friction
    slip.reject_touch(np.array([True, False, False]))
    gone = three_faces().without(np.array([False, True, True]))
    slip.step(300 * TICK, STILL, gone, 3.0 * FORCES)
    np.testing.assert_allclose(slip.learned_friction, learned, rtol=0.05)
    slip.step(301 * TICK, STILL, gone.without(ALL), 3.0 * FORCES)
    assert np.abs(slip.learned_friction / learned - 1.0).max() > 0.1


def test_jerks_along_the_grasp_force_of_each_finger_are_no_slip():
    """It has a tangential part at fingers 1 and 2, as f* may have."""
    shape = np.array([[1 / 8, 3 / 8, 0.0], [-1 / 8, 3 / 8, 0.0], [0.0, 1 / 4, 0.0]])
    slip, random = regulator(mode="auto"), np.random.default_rng(6)
    for i in range(100):
        jerk = random.standard_normal() if i > 50 else 0.0
        slip.step(i * TICK, STILL, three_faces(), (10.0 + jerk) * shape)
    assert (slip.state == STICK).all() and not slip.slip_likelihood.any()


def test_a_reserve_is_kept_up_to_four_fifths_of_the_limit_and_a_need_to_all_of_it():
    slip = regulator(mode="auto", maximum=40.0, reserve={"floor": 1e3})
    grasp_forces(slip, 60, three_faces(), FORCES)
    assert slip.grasp_force == pytest.approx(32.0, rel=1e-12) and slip.ready > 100.0
    heavy = FORCES + np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 9.0], [0.0, 0.0, 0.0]])
    grasp_forces(slip, 60, three_faces(), heavy, start=60)
    assert slip.grasp_force == 40.0 < slip.needed


def test_a_tick_that_comes_twice_changes_nothing():
    once, twice = regulator(mode="auto"), regulator(mode="auto")
    random = np.random.default_rng(4)
    for i in range(200):
        forces = FORCES + 0.02 * random.standard_normal((3, 3))
        found = [slip.step(i * TICK, STILL, three_faces(), forces) for slip in (once, twice)]
        found.append(twice.step(i * TICK, STILL, three_faces(), 5.0 * FORCES[::-1]))
        assert len(set(found)) == 1
        np.testing.assert_array_equal(once.slip_likelihood, twice.slip_likelihood)
        np.testing.assert_array_equal(once.learned_friction, twice.learned_friction)


HEAVY = FORCES + [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]


def shocked():
    """Return a regulator at tick 310, after a false slip and load, and friction and k_f before."""
    slip, random = regulator(mode="auto", maximum=200.0), np.random.default_rng(3)
    run(slip, 300)
    known, ready = slip.learned_friction, slip.ready
    for i in range(300, 310):
        shaken = 4.0 * FORCES * [0.2, 1.0, 0.2] + 0.4 * random.standard_normal((3, 3))
        slip.step(i * TICK, STILL, three_faces(), shaken)
    assert (slip.learned_friction < 0.9 * known).any()
    return slip, known, ready


def test_a_rejected_touch_leaves_neither_friction_nor_load_behind():
    """A false slip lowers the friction and a false load raises the margin; both are reverted."""
    slip, known, ready = shocked()
    held = slip.grasp_force
    slip.reject_touch(ALL)
    np.testing.assert_allclose(slip.learned_friction, known, rtol=0.01)
    assert (grasp_forces(slip, 40, three_faces(), 3.0 * FORCES[::-1], start=310) == held).all()
    assert (slip.state == UNKNOWN).all()
    slip.reject_touch(~ALL)
    grasp_forces(slip, 50, three_faces(), FORCES, start=350)
    np.testing.assert_allclose(slip.learned_friction, known, rtol=0.01)
    assert slip.ready == pytest.approx(ready, rel=0.03)


def test_a_load_that_has_come_while_touch_was_doubted_is_met_at_once():
    slip = regulator(mode="auto")
    run(slip, 300)
    slip.reject_touch(ALL)
    before = grasp_forces(slip, 100, three_faces(), HEAVY, start=300)[-1]
    slip.reject_touch(~ALL)
    assert slip.step(400 * TICK, STILL, three_faces(), HEAVY) == slip.needed > before + 0.5


def test_while_the_joints_are_held_the_load_counts_and_slips_do_not():
    """A guard hands over to k_f: a value from before the load would drop the object."""
    (slip, known, before), random = shocked(), np.random.default_rng(4)
    slip.joints_held = True
    np.testing.assert_allclose(slip.learned_friction, known, rtol=0.01)
    for i in range(310, 400):
        slip.step(i * TICK, STILL, three_faces(), HEAVY + 0.15 * random.standard_normal((3, 3)))
        assert (slip.state == UNKNOWN).all()
    np.testing.assert_allclose(slip.learned_friction, known, rtol=0.01)
    held = slip.step(400 * TICK, STILL, three_faces(), HEAVY)
    assert before + 0.5 < slip.needed <= held < 3.0 * slip.needed
    slip.joints_held = False
    assert slip.step(401 * TICK, STILL, three_faces(), HEAVY) == pytest.approx(held, rel=0.1)


def test_a_skin_that_freezes_while_it_shows_slip_does_not_drive_the_grasp_force_up():
    slip = regulator(mode="auto", maximum=200.0)
    run(slip, 300)
    for seed in range(100):  # until it is found
        shaken = FORCES + 0.15 * np.random.default_rng(seed).standard_normal((3, 3))
        slip.step((300 + seed) * TICK, STILL, three_faces(), shaken)
        if SLIP in slip.state:
            break
    found = slip.grasp_force
    grasp_forces(slip, 499, three_faces(), shaken, start=401)
    assert SLIP not in slip.state and slip.grasp_force < 3.0 * found


def test_what_is_released_and_grasped_again_may_be_another_object():
    slip = regulator(mode="auto")
    run(slip, 300)
    run(slip, 20, slides=(0, 1, 2))
    assert (slip.learned_friction != 0.4).any()
    slip.step(10**9, STILL, three_faces().without(ALL), np.zeros((3, 3)))
    np.testing.assert_array_equal(slip.learned_friction, 0.4)


def turned(contacts, rotation):
    """Return contacts in a rotated hand, with the frames reported by the skin of that hand."""
    return contacts_at(contacts.positions @ rotation.T, contacts.normals @ rotation.T)


@pytest.mark.parametrize("way", ["x to z", "y to z", "random 1", "random 2"])
def test_the_palm_may_be_turned_in_any_way(way):
    """With slips and a load, and a normal near palm z, where contact frames flip."""
    rotation, random = dict(orientations(2, seed=5))[way], np.random.default_rng(1)
    slips = [regulator(mode="auto", maximum=200.0) for _ in range(2)]
    for i in range(400):
        contacts = moved(three_faces(), rotation_from_vector([2e-3 * np.sin(i), 0, 0]), np.zeros(3))
        rms = 0.15 if 200 <= i < 215 else 0.005
        forces = FORCES * (1.0 + (i > 300)) + rms * random.standard_normal((3, 3))
        palm = in_palm(contacts.rotations, forces, 1.0)
        for slip, turn in zip(slips, (np.eye(3), rotation), strict=True):
            there = turned(contacts, turn)
            in_frames = np.einsum("kji,kj->ki", there.rotations, palm @ turn.T)
            slip.step(i * TICK, STILL, there, in_frames)
        plain, other = slips
        np.testing.assert_array_equal(plain.state, other.state)
        assert other.grasp_force == pytest.approx(plain.grasp_force, rel=1e-9)
        assert other.needed == pytest.approx(plain.needed, rel=1e-9, nan_ok=True)
        np.testing.assert_allclose(other.learned_friction, plain.learned_friction, rtol=1e-9)
    assert (plain.learned_friction != 0.4).any()


def test_a_regulator_without_a_past_keeps_its_grasp_force_while_touch_is_doubted():
    slip = regulator(mode="auto", grasp_force=7.0)
    slip.reject_touch(ALL)
    assert (grasp_forces(slip, 100, three_faces(), 9.0 * FORCES) == 7.0).all()


@pytest.mark.parametrize(("mode", "begins"), [("auto", True), ("shared", True), ("user", False)])
def test_a_new_regulator_starts_with_the_measured_grasp_force(mode, begins):
    """A crashed regulator may have held with more than the configured grasp force."""
    grasp, slow = three_faces(), {"rise_rate": 1.0}
    forces = in_palm(grasp.rotations, FORCES, 1.0)
    measured = split(grasp.positions, grasp.normals, forces).grasp_force
    for configured in (0.5 * measured, 2.0 * measured):
        slip = regulator(mode=mode, grasp_force=configured, maximum=10.0 * measured, reflex=slow)
        first = grasp_forces(slip, 2, grasp, FORCES)[-1]
        expected = max(configured, measured) if begins else configured
        assert first == pytest.approx(expected, rel=0.01)


def normal_run(slip, start, ticks, slides=False, seed=0):
    """Return k_f at ticks of 1 ms at which only normal forces are known."""
    random, told = np.random.default_rng(seed), []
    for i in range(start, start + ticks):
        forces = np.full((3, 3), np.nan)
        forces[:, 1] = FORCES[:, 1] + (0.15 if slides else 0.005) * random.standard_normal(3)
        told.append(slip.step(i * 1_000_000, STILL, three_faces(), forces))
    return np.array(told)


@pytest.mark.parametrize("mode", ["shared", "auto", "user"])
def test_without_tangential_forces_a_slip_raises_the_users_grasp_force_until_he_asks_again(mode):
    slip = regulator(mode=mode, grasp_force=8.0)
    assert (normal_run(slip, 0, 1000) == 8.0).all()
    assert np.isnan(slip.needed) and np.isnan(slip.carried.load).all()
    raised = normal_run(slip, 1000, 40, slides=True)
    assert raised[-1] == (8.0 if mode == "user" else 16.0)
    if mode == "user":
        assert SLIP in slip.state
        return
    rising = int(np.flatnonzero(raised > 8.0)[0])
    assert rising < 15 and raised[rising + 1] == 16.0  # 4 N per tick
    assert (slip.state == UNKNOWN).all()  # for 50 ms after the change, which looks like a slip
    assert (normal_run(slip, 1040, 2000) == 16.0).all() and (slip.state == STICK).all()
    again = normal_run(slip, 3040, 50, slides=True)
    assert again[-1] == 32.0
    slip.request(9.0)
    assert normal_run(slip, 3090, 4000)[-1] == pytest.approx(9.0)
    np.testing.assert_array_equal(slip.learned_friction, regulator().learned_friction)


def test_the_next_object_is_pressed_as_the_user_asks():
    slip = regulator(mode="auto", grasp_force=8.0)
    normal_run(slip, 0, 1000)
    assert normal_run(slip, 1000, 40, slides=True)[-1] == 16.0
    slip.step(1_040_000_000, STILL, three_faces().without(ALL), np.full((3, 3), np.nan))
    assert normal_run(slip, 1041, 2000)[-1] == pytest.approx(8.0)


def test_without_touch_the_required_grasp_force_is_unknown():
    slip = regulator(mode="auto")
    run(slip, 500)
    assert np.isfinite((slip.needed, slip.ready)).all()
    slip.step(500 * TICK, STILL, *NO_TOUCH)
    assert np.isnan((slip.needed, slip.ready)).all()


@pytest.mark.parametrize("bare", [[1], [0, 2], [0, 1, 2]])
def test_a_slip_is_seen_also_where_some_fingers_measure_normal_forces_only(bare):
    slip = regulator(mode="auto", grasp_force=8.0)
    random = np.random.default_rng(0)
    for i in range(1040):
        noise = 0.15 if i > 1000 else 0.005
        forces = FORCES + np.array([0.0, noise, 0.0]) * random.standard_normal((3, 1))
        forces[bare, ::2] = np.nan
        slip.step(i * 1_000_000, STILL, three_faces(), forces)
        assert i > 1000 or slip.grasp_force == 8.0
    assert slip.grasp_force == 16.0


def test_where_some_fingers_fail_to_measure_three_axes_the_grasp_force_does_not_fall():
    slip, forces = regulator(mode="auto"), FORCES.copy()
    run(slip, 500)
    before = slip.grasp_force
    forces[1, ::2] = np.nan
    assert (grasp_forces(slip, 500, three_faces(), forces, start=500) == before).all()


@pytest.mark.parametrize(
    ("bits", "gains", "latency", "seed"),
    [
        (12, "given", 0.005, 5),
        (12, "fitted", 0.0, 5),
        (14, "fitted", 0.0, 5),
        (20, "fitted", 0.0, 2),
    ],
)
def test_steps_of_the_encoders_in_the_torques_are_no_slip(bits, gains, latency, seed):
    """A sudden pull moves the joints, and so the steps of their angles into the torques."""
    changes = {"plant.encoder.bits": bits, "seed": seed, "duration": 3.0}
    changes |= {"tactile_sensor.latency": latency}
    if gains == "fitted":
        changes |= {"manipulation_controller.law.damping": 0.0}
    loop = ClosedLoop(load_scenario("pull", changes))
    assert not (loop.run().grip == ContactState.SLIP).any()
