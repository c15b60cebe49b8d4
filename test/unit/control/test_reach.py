# SPDX-License-Identifier: Apache-2.0
"""Poses to which a hand can carry its grasp, and the cost of judging them.

The cost counts in evaluated postures, because a pose is judged within a tick.
"""

from unittest.mock import Mock

import numpy as np
import pytest
from support.controllers import TICK, Bench
from support.grasps import contacts_at, moved
from support.hands import prism_grasp, write_hand
from support.plants import plant

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.grasp import VirtualFrame
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.margins import GraspMonitor
from tactile_hand_ros.control.reach import check_reach, end_of, inverse_kinematics, room
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector, vector_from_rotation
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

START = np.tile([1.047, 0.0, 1.571], 3)


@pytest.mark.parametrize("seed", range(5))
def test_inverse_kinematics_finds_angles_for_reachable_tips(seed):
    hand = Hand.load("paper")
    random = np.random.default_rng(seed)
    wanted = hand.fingertips(START + random.uniform(-0.3, 0.3, 9)).positions
    theta, missing = inverse_kinematics(hand, wanted, START)
    assert missing.max() < 1e-6
    np.testing.assert_allclose(hand.fingertips(theta).positions, wanted, atol=1e-6)


def test_inverse_kinematics_says_how_much_is_missing(tmp_path):
    hand = Hand.load(str(write_hand(tmp_path, [3, 4, 5])))
    straight_up = np.array([[0.3, 0.0, 2.0], [-0.15, 0.26, 0.4], [-0.15, -0.26, 0.4]])
    _, missing = inverse_kinematics(hand, straight_up, np.full(hand.joints, 0.3))
    assert missing[0] == pytest.approx(1.4, abs=0.01) and missing[1:].max() < 1e-3
    straight = hand.fingertips(np.zeros(hand.joints)).positions
    np.testing.assert_allclose(np.linalg.norm(straight - hand.bases, axis=1), hand.spans)


def test_joint_limits_are_kept():
    hand, start = Hand.load("human"), np.tile([1.3, 0.0, 1.1], 3)
    beyond = start + np.tile([0.0, 1.2, 0.0], 3)  # abduction ends at 0.8
    theta, missing = inverse_kinematics(hand, hand.fingertips(beyond).positions, start)
    assert np.abs(theta.reshape(3, 3)[:, 1]).max() <= 0.8
    assert missing.max() > 1e-3


class Carried:
    """A grasp carried by a rigid motion, so that its fingertips reach given places.

    Fingertips, normals and motion are asymmetric, so that any mix-up shows.
    """

    def __init__(self):
        self.hand = Hand.load("paper")
        self.hand.radii = np.array([0.06, 0.03, 0.05])
        self.shift = np.array([0.03, -0.04, 0.02])
        self.turn = rotation_from_vector([0.3, -0.2, 0.4])
        self.before = rotation_from_vector([-0.5, 0.3, 0.7])
        self.theta = START + np.linspace(-0.15, 0.15, 9)
        self.tips = self.hand.fingertips(self.theta).positions

    def stretch(self, finger, beyond):
        """Request a fingertip position at a distance beyond the straight finger."""
        straight = self.theta.copy()
        straight[3 * finger + 2] = 0.0
        reached = self.hand.fingertips(straight)
        block = reached.linear[finger, :, 3 * finger : 3 * finger + 3]
        outward = np.linalg.svd(block)[0][:, 2]  # no joint can move it this way
        outward *= np.sign(outward @ (reached.positions[finger] - self.tips[finger]))
        self.tips[finger] = reached.positions[finger] + beyond * outward

    def check(self):
        contacts = contacts_at(self.tips, [[-1.0, 0.2, 0.1], [0.9, 0.3, -0.2], [0.1, -1.0, 0.3]])
        points = self.tips + self.hand.radii[:, None] * contacts.normals
        there = Contacts(points, contacts.rotations)
        now = moved(there, self.turn.T, -self.turn.T @ self.shift)
        pose = AuxiliaryPose(now.centroid, self.before)
        target = Target(self.turn @ now.centroid + self.shift, self.turn @ self.before)
        try:
            check_reach(self.hand, START, now, pose, target)
        except PoseError as error:  # its contacts lie anywhere on the fingertips
            if "short" in str(error):
                raise


@pytest.mark.parametrize("finger", range(3))
def test_a_sixth_of_its_radius_may_be_missing_of_a_fingertip_and_no_more(finger):
    grasp = Carried()
    allowed = grasp.hand.radii[finger] / 6.0
    grasp.stretch(finger, 0.99 * allowed)
    grasp.check()
    grasp = Carried()
    grasp.stretch(finger, 1.01 * allowed)
    short = f"finger_{finger + 1} would stay {1e3 * allowed:.0f} mm short"
    with pytest.raises(PoseError, match=short):
        grasp.check()


@pytest.mark.parametrize(
    ("beyond", "expected"),
    [
        ((0.015, 0.023, 0.0), "finger_2 would stay 23 mm short"),
        ((0.041, 0.0, 0.023), "finger_1 would stay 41 mm short"),
        ((0.005, 0.012, 0.037), "finger_3 would stay 37 mm short"),
    ],
)
def test_the_finger_that_misses_most_is_named_with_what_is_missing(beyond, expected):
    grasp = Carried()
    for finger, distance in enumerate(beyond):
        grasp.stretch(finger, distance)
    with pytest.raises(PoseError, match=expected):
        grasp.check()


SHORT = r"finger_\d would stay.*\(0.000, 0.043, 0.410\) m"


@pytest.mark.parametrize(
    ("position", "turn", "reason"),
    [
        ([2.0, 0.0, 0.4], [0.0, 0.0, 0.0], SHORT),
        ([0.0, 0.0434, 0.9], [2.5, 0.0, 0.0], SHORT),
        ([np.nan, 0.0, 0.4], [0.0, 0.0, 0.0], "must be finite numbers"),
        ([0.0, 0.0, 0.4], [np.nan, 0.0, 0.0], "must be finite numbers"),
    ],
)
def test_what_is_out_of_reach_or_not_finite_is_refused_with_the_reason(position, turn, reason):
    hand, state = plant().hand, plant().state
    pose = AuxiliaryPose(state.contacts.centroid, np.eye(3))
    target = Target(np.array(position), rotation_from_vector(turn))
    with pytest.raises(PoseError, match=reason):
        check_reach(hand, state.theta, state.contacts, pose, target)


def turned(name, degrees, duration):
    """Return a loop of a scenario whose only target is a rotation about palm z."""
    scenario = load_scenario(name)
    contacts = Plant(scenario.plant).state.contacts
    there = rotation_from_vector([0.0, 0.0, np.radians(degrees)])
    rotation = vector_from_rotation(there @ VirtualFrame().orientation(contacts.positions))
    target = {"position": contacts.centroid.tolist(), "rotation": rotation.tolist()}
    changes = {"targets": [{"time": 0.2, **target}], "duration": duration}
    return ClosedLoop(load_scenario(name, changes))


@pytest.mark.parametrize(
    ("name", "degrees"), [("gravity", 72), ("gravity", -72), ("human_hold", 45)]
)
def test_a_turn_that_rolls_a_contact_over_the_rim_is_refused(name, degrees):
    with pytest.raises(PoseError, match="degrees over the rim of its fingertip; ask for a smaller"):
        turned(name, degrees, 1.0)


def test_a_move_ends_where_a_contact_nears_the_rim_and_may_go_back():
    """The prediction is off by a few degrees: this rotation is accepted, but ends on its way."""
    loop = turned("human_hold", 41, 2.6)
    hand, watch = loop.controller.hand, GraspMonitor(loop.controller.hand)
    points = loop.state.contacts.positions
    home = Target(points.mean(axis=0), VirtualFrame().orientation(points))
    stops, margins = [], []
    record = Record.empty(2600, hand.finger_names, hand.joint_names)
    for row in range(2600):
        command = loop.answer(record, row)
        margins.append(watch.margins(record.theta[row], loop.state.contacts).hemisphere)
        if "the move ends here: it brings the contact of middle to the rim" in command.reason:
            stops.append(row)
        if row == 2200:
            loop.controller.targets.command(home)
        loop.advance(command.torque)
    assert len(stops) == 1 and stops[0] < 2150  # it stays there until it goes back
    assert margins[stops[0]] == pytest.approx(0.05 * np.pi, abs=0.02)
    assert 0.0 < margins[2200] < 0.2 and margins[-1] > margins[2200] + 0.1
    assert record.true_slid.max() < 1e-5


def test_fractions_are_left_to_the_rims_and_to_the_ends_of_the_joints():
    hand, start = Hand.load("human"), np.tile([1.3, 0.0, 1.1], 3)
    for finger, tilt, bent, expected, place in (
        (0, 0.0, 0.0, 2.2 / 2.9, "flexion to its end"),  # the first joint, from -0.5 to 2.4 rad
        (0, 0.0, 0.4, 0.5, "thumb_abduction to its end"),
        (2, 0.0, -0.72, 0.1, "middle_abduction to its end"),
        (1, 0.8 * np.pi / 2.0, 0.4, 0.2, "contact of index to the rim"),
        (1, 1.2 * np.pi / 2.0, 0.0, -0.2, "contact of index to the rim"),
    ):
        theta = start.copy()
        name = hand.finger_names[finger]
        theta[hand.joint_names.index(f"{name}_abduction")] = bent
        frames = hand.tip_rotations(theta)
        normals = frames[:, :, 0].copy()  # as far from the rims as possible
        normals[finger] = np.cos(tilt) * frames[finger, :, 0] + np.sin(tilt) * frames[finger, :, 2]
        tips = hand.fingertips(theta).positions
        left = room(hand, theta, contacts_at(tips, normals))
        assert left.min() == pytest.approx(expected)
        assert place in end_of(hand, int(left.argmin()))


FAR = (0.0, 0.0, 2.0)


@pytest.fixture
def looks(monkeypatch):
    """Return a list that collects the joint angles of each posture evaluated by a hand."""
    seen = []
    fingertips = Hand.fingertips

    def counted(hand, theta):
        seen.append(theta)
        return fingertips(hand, theta)

    monkeypatch.setattr(Hand, "fingertips", counted)
    return seen


@pytest.fixture
def checks(monkeypatch):
    """Return a mock that counts the poses whose reach the controller has checked."""
    counted = Mock(wraps=check_reach)
    monkeypatch.setattr("tactile_hand_ros.control.targets.check_reach", counted)
    return counted


class Grasp:
    """The first grasp of a plant, and its estimate by the hand."""

    def __init__(self, world):
        self.hand, self.theta, self.contacts = world.hand, world.state.theta, world.state.contacts
        self.pose = AuxiliaryPose(self.contacts.centroid, rotation_from_vector([0.3, -0.2, 0.5]))

    def target(self, shift, turn=(0.0, 0.0, 0.0)):
        turned = rotation_from_vector(np.asarray(turn)) @ self.pose.orientation
        return Target(self.pose.position + np.asarray(shift), turned)

    def check(self, *motion):
        check_reach(self.hand, self.theta, self.contacts, self.pose, self.target(*motion))

    def is_in_reach(self, *motion):
        try:
            self.check(*motion)
        except PoseError as error:
            return "over the rim" in str(error)  # the fingertips reach it
        return True

    def can_follow(self, shift, turn=(0.0, 0.0, 0.0)):
        """Judge by a hundred steps, without stopping early."""
        tips = self.contacts.positions - self.hand.radii[:, None] * self.contacts.normals
        about = (tips - self.pose.position) @ rotation_from_vector(np.asarray(turn)).T
        wanted = self.pose.position + np.asarray(shift) + about
        _, missing = inverse_kinematics(self.hand, wanted, self.theta)
        return bool((missing <= self.hand.radii / 6.0).all())


def motions(count, seed):
    random = np.random.default_rng(seed)
    for _ in range(count):
        shift, turn = random.normal(size=3), random.normal(size=3)
        length = 10 ** random.uniform(-2.0, 0.2)
        angle = random.choice([0.0, 0.3, 1.0, 2.5]) * random.uniform()
        yield length * shift / np.linalg.norm(shift), angle * turn / np.linalg.norm(turn)


@pytest.fixture(scope="module", params=["three fingers", "seventeen joints"])
def grasp(request, tmp_path_factory):
    if request.param == "three fingers":
        return Grasp(plant())
    values = prism_grasp(tmp_path_factory.mktemp("hand"), [6, 5, 3, 3])
    return Grasp(Plant(load_scenario("paper", values).plant))


def test_a_check_looks_at_few_postures_and_judges_as_a_hundred_steps_do(grasp, looks):
    verdicts = []
    for motion in motions(150, seed=3):
        looks.clear()
        verdicts.append(grasp.is_in_reach(*motion))
        assert len(looks) <= 32 + 24  # without and with rolling
        assert verdicts[-1] == grasp.can_follow(*motion)
    assert 30 < sum(verdicts) < 120


def test_what_no_outstretched_finger_reaches_is_refused_without_a_look(grasp, looks):
    with pytest.raises(PoseError, match=r"would stay \d+ mm short of its contact even outstretch"):
        grasp.check(FAR)
    assert not looks


def test_the_present_pose_is_judged_by_one_look(grasp, looks):
    grasp.check((0.0, 0.0, 0.0))
    assert len(looks) == 1


def test_fingers_with_joints_to_spare_are_solved_to_the_end(tmp_path):
    """Without any damping, the system of a finger with six joints has no solution."""
    grasp = Grasp(Plant(load_scenario("paper", prism_grasp(tmp_path, [6, 5, 4, 3, 3])).plant))
    shift = 0.11, 0.13, -0.03
    assert grasp.can_follow(shift) and grasp.is_in_reach(shift)


@pytest.fixture
def bench():
    return Bench()


def test_a_pose_that_is_said_again_and_again_is_judged_once_until_a_reset(bench, checks):
    bench.step()
    for _ in range(5):
        bench.controller.targets.command(bench.target(0.05, 0.0, 0.0))
        bench.step()
    assert checks.call_count == 1
    turned = bench.target(0.05, 0.0, 0.0, turn=(0.0, 0.0, 0.01))
    for other in (turned, bench.target(0.04, 0.0, 0.0)):
        bench.controller.targets.command(other)
        bench.step()
    assert checks.call_count == 3
    bench.controller.reset()
    bench.step()
    bench.controller.targets.command(bench.target(0.04, 0.0, 0.0))
    assert checks.call_count == 4


def test_of_poses_that_came_before_the_first_grasp_only_the_newest_is_judged(bench, checks):
    for shift in ((0.01, 0.0, 0.0), FAR):
        bench.controller.targets.command(bench.target(*shift))
    command = bench.step()
    assert command.mode is Mode.DRIVE and "out of reach" in command.reason
    assert bench.step().reason == "" and bench.shift[0] == 0.0 and checks.call_count == 1


def test_a_new_grasp_judges_what_waits_anew(bench, checks):
    bench.step()
    waiting, again = bench.target(0.04, 0.0, 0.0), bench.target(0.05, 0.0, 0.0)
    bench.controller.targets.command(waiting, stamp=4 * TICK)
    bench.step()
    bench.controller.targets.command(again, stamp=9 * TICK)
    bench.controller.release()
    bench.step()
    bench.controller.grasp()
    bench.step()
    assert not bench.controller.is_open and checks.call_count == 2
    bench.controller.targets.command(again, stamp=8 * TICK)
    bench.step(3)
    later = [call.args[-1] for call in checks.call_args_list[2:]]
    assert [id(target) for target in later] == [id(again), id(waiting)]
    assert bench.shift[0] == pytest.approx(0.04)
