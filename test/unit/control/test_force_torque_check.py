# SPDX-License-Identifier: Apache-2.0
"""Forces that contradict the joint torques are detected; impacts and slow skins are accepted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.grasps import FORCES
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts, in_palm, joint_torques
from tactile_hand_ros.control.plausibility import ForceTorqueCheck, Tolerances
from tactile_hand_ros.control.sensing import JointRates
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.simulation.joint_sensor import EncoderConfig, JointSensor
from tactile_hand_ros.simulation.palm_motion import PalmTurn, palm_turning

TICK = 2_000_000
PLANT = plant()
STATE = PLANT.state
CONTACTS = Contacts(STATE.contacts.positions, STATE.contacts.rotations)
TERMS = PLANT.hand.dynamics(STATE.theta, np.zeros(9))


def torque(forces):
    """Return the joint torques at rest for forces in contact frames."""
    pressing = in_palm(CONTACTS.rotations, forces, 1.0)
    return joint_torques(TERMS[0], CONTACTS.positions, pressing) + TERMS[2]


def verdicts(seen, tolerance=0.3, watch=None, latency=0.0):
    """Return the verdicts on ticks: timestamp in ms, rates, model, forces and torque of each."""
    watch, limits = watch or ForceTorqueCheck(PLANT.hand), Tolerances(0.0, tolerance, latency)
    return [
        watch.step(round(1e6 * stamp), rates, terms, CONTACTS, forces, applied, limits)
        for stamp, rates, terms, forces, applied in seen
    ]


def at_rest(stamps, forces, applied):
    return [(stamp, np.zeros(9), TERMS, forces, applied) for stamp in stamps]


def first_doubt(sensed, applied, ticks=100, latency=0.0):
    """Return the first tick at which forces and torques, functions of the tick, are doubted."""
    seen = [at_rest((2.0 * i,), sensed(i), torque(applied(i)))[0] for i in range(ticks)]
    found = verdicts(seen, latency=latency)
    return next((tick for tick, verdict in enumerate(found) if verdict), None)


def noisy(tick):
    return FORCES + 1e-3 * np.sin(tick + np.arange(9.0)).reshape(3, 3)


def scaled(at, factor=2.0):
    """Return forces that are multiplied by a factor from a tick on."""
    return lambda tick: noisy(tick) * (factor if tick >= at else 1.0)


def one_stays(tick):
    """Return forces of which only those of the first finger do not grow at tick 50."""
    return np.vstack([noisy(min(tick, 49))[:1], scaled(50, 4.0)(tick)[1:]])


def stuck(tick):
    return np.vstack([FORCES[:1], noisy(tick)[1:]])


def growing(tick):
    return noisy(tick) * [[1.0 + 0.004 * tick], [1.0], [1.0]]


@pytest.mark.parametrize(
    ("sensed", "applied", "latency", "first"),
    [
        (noisy, noisy, 0.0, None),
        (growing, growing, 0.0, None),
        (noisy, lambda i: noisy(i) * (1.5 if i == 50 else 1.0), 0.0, None),  # an impact
        (stuck, noisy, 0.0, None),  # it repeats at rest
        (stuck, growing, 0.0, range(21, 60)),
        # Forces of a late skin are compared with the torques of their time.
        (scaled(53), scaled(50), 0.0, range(50, 53)),
        (scaled(53), scaled(50), 0.015, None),
        (scaled(57), scaled(50), 0.015, None),
        # Torques from 15 ms ago are still accepted, those from 30 ms ago are not.
        (noisy, scaled(50), 0.015, range(58, 68)),
        (noisy, scaled(50, 0.5), 0.015, range(58, 68)),
        (one_stays, scaled(50, 4.0), 0.015, range(50, 54)),  # no delay fits all three
        (scaled(50, -1.0), noisy, 0.015, range(50, 53)),  # under steady torques
        # Nothing is compared until the first forces may have come.
        (scaled(0, 3.0), noisy, 0.0, range(1, 2)),
        (scaled(0, 3.0), noisy, 0.015, range(9, 11)),
    ],
)
def test_forces_are_doubted_that_no_torque_since_their_time_explains(
    sensed, applied, latency, first
):
    found = first_doubt(sensed, applied, latency=latency)
    assert found is None if first is None else found in first


ONE = np.array([[-3.0, 3.0, -3.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
WEAK = np.array([[1.0] * 3, [0.3] * 3, [1.0] * 3])
FLIPPED = np.array([[1.0] * 3, [1.0] * 3, [-1.0, 1.0, -1.0]])


@pytest.mark.parametrize("factor", [ONE, WEAK, FLIPPED, np.array([-3.0, 3.0, -3.0]), 0.0])
def test_forces_of_a_finger_or_all_that_are_wrong_are_doubted_within_some_ticks(factor):
    """For example, a finger that reports 0.3 of its force, or friction with the wrong sign."""

    def right(tick):
        return noisy(tick) + [[0.0] * 3, [0.0] * 3, [1.2, 0.0, -1.5]]

    assert first_doubt(right, right) is None
    assert first_doubt(lambda i: right(i) * (factor if i >= 50 else 1.0), right) in range(50, 55)


@given(st.integers(0, 2), st.integers(0, 8), st.floats(0.0, 0.2))
def test_a_finger_whose_error_is_below_the_tolerance_is_accepted(finger, joint, error):
    torques = torque(FORCES)
    own = slice(3 * finger, 3 * finger + 3)
    wrong = torques.copy()
    wrong[own] += error * np.linalg.norm(torques[own]) * np.eye(3)[joint % 3]
    assert not any(verdicts(at_rest(2.0 * np.arange(40), FORCES, wrong)))


def test_what_encoders_make_up_is_no_error():
    """At constant speed, rates from a 12-bit encoder look like inertia."""
    encoder = EncoderConfig(bits=12)
    joints, made = JointSensor(encoder, 0.0, 0.002, 1), JointRates(9)
    watches = ForceTorqueCheck(PLANT.hand), ForceTorqueCheck(PLANT.hand)
    doubts = np.zeros(2, dtype=int)
    for tick in range(300):
        true = np.linspace(-0.3, 0.3, 9) * 0.002 * tick
        seen = joints.step(true, true, true)
        rate = made.step(tick * TICK, *seen[:2], encoder.resolution)
        for i, error in enumerate((np.zeros(9), made.error)):
            pressing = noisy(tick), torque(FORCES), Tolerances(0.0, 0.02, 0.0, error)
            doubts[i] += bool(watches[i].step(tick * TICK, rate, TERMS, CONTACTS, *pressing))
    assert doubts[0] > 0 and doubts[1] == 0


def turning(angle, imu):
    """Return whether a finger is doubted as the palm turns by an angle, rad, at rest in it.

    The joints carry the inertia of the links as given by the model.
    """
    hand, watch = Hand.load("paper"), ForceTorqueCheck(PLANT.hand)
    goal = 0.6 * angle, 0.0, 0.8 * angle
    turns = [PalmTurn(time=0.05, rotation=(0.0,) * 3), PalmTurn(time=0.35, rotation=goal)]
    for tick in range(150):
        palm = palm_turning(turns, 1e-9 * tick * TICK)
        carried = hand.turning_torque(STATE.theta, np.zeros(9), palm.rate, palm.acceleration)
        seen = noisy(tick), torque(FORCES) + carried, Tolerances(0.0, 0.3, 0.0)
        known = palm.rotation if imu else None
        if watch.step(tick * TICK, np.zeros(9), TERMS, CONTACTS, *seen, known):
            return True
    return False


def test_what_a_turning_palm_takes_of_the_joints_is_no_error_where_an_imu_shows_it():
    assert turning(0.2, imu=False) and not turning(0.8, imu=True)


def test_an_imu_in_a_palm_at_rest_does_not_widen_the_tolerance():
    watch = ForceTorqueCheck(PLANT.hand)
    for tick in range(300):
        palm = rotation_from_vector([0.02 * min(tick, 50), 0.0, 0.0])
        wrong = 1.0 if tick < 290 else 3.0
        seen = wrong * noisy(tick), torque(FORCES), Tolerances(0.0, 0.3, 0.0), palm
        found = watch.step(tick * TICK, np.zeros(9), TERMS, CONTACTS, *seen)
        assert bool(found) == (tick > 291) or tick in (290, 291)


def test_a_new_grasp_starts_without_a_past():
    watch = ForceTorqueCheck(PLANT.hand)
    first, second, third = at_rest((0.0, 2.0, 4.0), FORCES, torque(0.2 * FORCES))
    before, after = verdicts([first, second], watch=watch)
    assert before is None and after
    watch.reset()
    assert verdicts([third], watch=watch) == [None]


def test_inertia_weight_and_the_time_between_ticks_count():
    """Torques that accelerate and carry the links are no contact forces: all signs matter."""
    hand = Hand.load("paper", gravity=np.array([10.0, -20.0, -90.0]))
    random, stamps = np.random.default_rng(2), (0.0, 2.0, 6.0, 7.0)
    before, seen = np.zeros(9), []
    for last, stamp in zip((-2.0, *stamps), stamps, strict=False):
        rates = before + random.uniform(-0.1, 0.1, 9)
        terms = hand.dynamics(STATE.theta, rates)
        moving = terms[1] @ (rates - before) / (1e-3 * (stamp - last)) + terms[2]
        assert np.linalg.norm(terms[2]) > 0.5 and np.linalg.norm(moving - terms[2]) > 0.3
        seen.append((stamp, rates, terms, FORCES, torque(FORCES) + moving))
        before = rates
    assert verdicts(seen, 0.0) == [None] * 4
    for i in range(1, 4):
        stamp, rates, terms, forces, applied = seen[i]
        assert any(verdicts([*seen[:i], (stamp, rates, terms, forces, applied - terms[2])], 0.0))


def test_a_tick_that_comes_again_or_is_older_says_nothing():
    seen = at_rest((4.0, 4.0, 2.0), FORCES, torque(0.2 * FORCES))
    assert verdicts(seen) == [None] * 3
    assert verdicts([*seen, *at_rest((3.0,), FORCES, torque(0.2 * FORCES))])[3]


def frozen(change, stamps, joint=3, latency=0.0):
    """Return whether finger 2, which repeats its force, is doubted after a change of a torque."""
    base, seen = torque(FORCES), []
    for tick, stamp in enumerate((0.0, 1.0, *stamps)):
        applied = base + (change * np.eye(9)[joint] if tick > 1 else 0.0)
        moving = noisy(tick)
        moving[1] = FORCES[1]
        seen += at_rest((stamp,), moving, applied)
    return verdicts(seen, 1e3, latency=latency)


MINIMUM = PLANT.hand.minimum_force * PLANT.hand.spans[1]
LIMIT = MINIMUM + 0.05 * np.abs(torque(FORCES)[3:6]).max()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_finger_may_repeat_its_force_under_a_twentieth_more_torque_and_as_much_again(sign):
    """And under the torque of a hundredth of its weight, which moves nothing."""
    stamps = (1000.0, 1001.0)  # the average has settled
    assert np.abs(torque(FORCES)).max() > 1.1 * np.abs(torque(FORCES)[3:6]).max()
    assert not any(frozen(0.999 * sign * LIMIT, stamps))
    reason = frozen(1.001 * sign * LIMIT, stamps)[-1].reason
    assert reason.startswith("the forces of a finger do not")
    assert not any(frozen(5.0 * sign * LIMIT, stamps, joint=1))  # of another finger


@pytest.mark.parametrize(("latency", "last"), [(0.0, 6.0), (0.015, 36.0)])
def test_a_finger_may_repeat_its_force_for_twice_its_age(latency, last):
    """Plus 5 ms for the average and 1 ms from the start of the comparison."""
    found = [frozen(1.0, (5.0, last + late), latency=latency)[-1] for late in (-0.1, 0.1)]
    assert [bool(each) for each in found] == [False, True]


@pytest.mark.parametrize(("factor", "found"), [(0.999, False), (1.001, True)])
def test_the_finest_of_all_changes_of_a_force_counts(factor, found):
    """One component changes by 1 mN first, and later all of them by more."""
    base = torque(FORCES)
    lever = np.linalg.norm(TERMS[0].linear[1], axis=0).max()
    limit = 0.01 * (np.abs(base[3:6]).max() + MINIMUM) + 3.0 * lever * 0.001
    changed = base + factor * limit * np.eye(9)[3]
    shifts = ([0.0] * 3, [0.2, 0.0, 0.3], [0.2, 0.001, 0.7], [0.0] * 3, [0.0] * 3, [0.0] * 3)
    seen = []
    for tick, (stamp, shift) in enumerate(zip((0, 1, 2, 3, 1000, 1001), shifts, strict=True)):
        moving = noisy(tick)
        moving[1] = FORCES[1] + shift
        seen += at_rest((stamp,), moving, changed if tick > 3 else base)
    assert bool(verdicts(seen, 1e3)[-1]) == found
