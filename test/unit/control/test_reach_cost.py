# SPDX-License-Identifier: Apache-2.0
"""The cost of judging a pose, in evaluated postures, because it is done within a tick."""

import numpy as np
import pytest
from support.controllers import TICK, Bench
from support.hands import prism_grasp, write_hand
from support.plants import plant

from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.reach import check_reach, inverse_kinematics
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

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
    """Return a list that collects each pose whose reach the controller has checked."""
    judged = []

    def counted(hand, theta, contacts, pose, target):
        judged.append(target)
        check_reach(hand, theta, contacts, pose, target)

    monkeypatch.setattr("tactile_hand_ros.control.targets.check_reach", counted)
    return judged


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

    def can_follow(self, shift, turn):
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
        before = len(looks)
        verdicts.append(grasp.is_in_reach(*motion))
        assert len(looks) - before <= 32 + 24  # without and with rolling
        assert verdicts[-1] == grasp.can_follow(*motion)
    assert 30 < sum(verdicts) < 120


def test_what_no_outstretched_finger_reaches_is_refused_without_a_look(grasp, looks):
    with pytest.raises(PoseError, match=r"would stay \d+ mm short of its contact even outstretch"):
        grasp.check(FAR)
    assert not looks


def test_the_present_pose_is_judged_by_one_look(grasp, looks):
    grasp.check((0.0, 0.0, 0.0))
    assert len(looks) == 1


def test_a_search_that_leads_somewhere_gets_its_time(looks):
    """This rotation leads the fingers far around, along their joint limits."""
    grasp = Grasp(plant())
    for ends, limit in zip(grasp.hand.position_limits, (-1.5708, 1.5708), strict=True):
        ends[1::3] = limit  # abduction
    grasp.pose = AuxiliaryPose(grasp.contacts.centroid, np.eye(3))
    assert grasp.is_in_reach((-0.02, -0.07, -0.35), (2.0, 0.6, -2.5))
    assert 20 < len(looks) <= 32 + 24


def test_a_search_that_leads_nowhere_ends_early(looks):
    """Behind the palm no tip is too far away, but the joint limits come first."""
    grasp, motion = Grasp(plant()), ((0.0, 0.0, -0.4), (0.0, 1.0, 0.0))
    with pytest.raises(PoseError, match=r"would stay \d+ mm short of its contact; ask"):
        grasp.check(*motion)
    assert 3 < len(looks) < 20
    looks.clear()
    assert not grasp.can_follow(*motion) and len(looks) > 40


@pytest.mark.parametrize("joints", [[3, 4, 5], [2, 6, 3]])
def test_no_posture_leads_a_tip_beyond_its_span_and_the_straight_one_does_to_its_end(
    tmp_path, joints
):
    hand = Hand.load(str(write_hand(tmp_path, joints)))
    random, (lower, upper) = np.random.default_rng(1), hand.position_limits
    for _ in range(50):
        tips = hand.fingertips(random.uniform(lower, upper)).positions
        assert (np.linalg.norm(tips - hand.bases, axis=1) <= hand.spans + 1e-12).all()
    straight = hand.fingertips(np.zeros(hand.joints)).positions
    np.testing.assert_allclose(np.linalg.norm(straight - hand.bases, axis=1), hand.spans)


def test_fingers_with_joints_to_spare_are_solved_to_the_end(tmp_path):
    """Without any damping, the system of a finger with six joints has no solution."""
    grasp = Grasp(Plant(load_scenario("paper", prism_grasp(tmp_path, [6, 5, 4, 3, 3])).plant))
    motion = (0.11, 0.13, -0.03), (0.0, 0.0, 0.0)
    assert grasp.can_follow(*motion) and grasp.is_in_reach(*motion)


def along(bench, x):
    return bench.target(x, 0.0, 0.0)


@pytest.fixture
def bench():
    return Bench()


def test_of_several_poses_each_is_judged_once(bench, checks):
    bench.step()
    for ticks in (3, 5):
        bench.controller.targets.command(along(bench, 0.01 * ticks), stamp=ticks * TICK)
    found = []
    for _ in range(6):
        bench.step()
        found.append(bench.shift[0])
    np.testing.assert_allclose(found, [0.0, 0.0, 0.03, 0.03, 0.05, 0.05], atol=1e-12)
    assert len(checks) == 2


def test_a_pose_that_is_said_again_and_again_is_judged_once(bench, checks):
    bench.step()
    for _ in range(5):
        bench.controller.targets.command(along(bench, 0.05))
        bench.step()
    assert len(checks) == 1
    turned = bench.target(0.05, 0.0, 0.0, turn=(0.0, 0.0, 0.01))
    for other in (turned, along(bench, 0.04)):
        bench.controller.targets.command(other)
        bench.step()
    assert len(checks) == 3


def test_one_tick_judges_one_pose_the_newest_first(bench, checks):
    """All poses came before the first grasp; the first one in reach replaces the older ones."""
    for shift in (0.01, 0.02):
        bench.controller.targets.command(along(bench, shift))
    for _ in range(2):
        bench.controller.targets.command(bench.target(*FAR))
    for refused in range(2):
        command = bench.step()
        assert command.mode is Mode.DRIVE and "out of reach" in command.reason
        assert len(checks) == refused + 1 and bench.shift[0] == 0.0
    assert bench.step().reason == "" and bench.shift[0] == pytest.approx(0.02)
    for _ in range(3):
        bench.step()
    assert len(checks) == 3 and bench.shift[0] == pytest.approx(0.02)


def test_what_is_said_while_older_poses_wait_comes_after_them(bench, checks):
    bench.controller.targets.command(along(bench, 0.01), stamp=1)
    bench.controller.targets.command(bench.target(*FAR), stamp=2)
    bench.stamp = TICK
    assert "out of reach" in bench.step().reason
    bench.controller.targets.command(along(bench, 0.02))
    bench.controller.targets.command(along(bench, 0.03), stamp=4 * TICK)
    bench.step()
    assert bench.shift[0] == pytest.approx(0.02)
    bench.step()
    bench.step()
    assert bench.shift[0] == pytest.approx(0.03) and bench.stamp == 5 * TICK


def test_a_new_grasp_judges_what_waits_anew(bench, checks):
    bench.step()
    waiting, again = along(bench, 0.04), along(bench, 0.05)
    bench.controller.targets.command(waiting, stamp=4 * TICK)
    bench.step()
    bench.controller.targets.command(again, stamp=9 * TICK)
    bench.controller.release()
    bench.step()
    bench.controller.grasp()
    bench.step()
    assert not bench.controller.is_open and len(checks) == 2
    bench.controller.targets.command(again, stamp=8 * TICK)
    for _ in range(3):
        bench.step()
    assert [id(target) for target in checks[2:]] == [id(again), id(waiting)]
    assert bench.shift[0] == pytest.approx(0.04)


def test_a_reset_forgets_what_was_in_reach(bench, checks):
    bench.step()
    bench.controller.targets.command(along(bench, 0.05))
    bench.controller.reset()
    bench.step()
    bench.controller.targets.command(along(bench, 0.05))
    assert len(checks) == 2
