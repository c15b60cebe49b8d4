# SPDX-License-Identifier: Apache-2.0
"""A run on disk yields the recorded arrays, and reports its defects."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from support.hands import write_hand
from support.messages import force_message, joint_message, pose_message, serialized
from support.recorded import (
    LATENCY,
    PERIOD,
    START,
    RunWriter,
    assert_same,
    random_record,
    request_message,
    write_record,
    write_tick,
)

from tactile_hand_ros.bag.reader import TopicMessages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.run.reading import find_fingers, find_prefix, sections
from tactile_hand_ros.run.result import columns
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved

STRAIGHT = (0.0, 0.0, 0.0, 1.0)
NAMES = ["a", "b"]


def tick_only(bag: RunWriter, stamp: int, at: int) -> None:
    bag.write("/joint_states", joint_message(NAMES, stamp, position=[1.0, 2.0]), at)


class TestRecord:
    @pytest.mark.parametrize("truth", [True, False])
    def test_is_what_was_recorded(self, tmp_path, truth):
        """A real hand has no ground truth, and its bag is complete without it."""
        record = random_record(truth=truth)
        run = Run(write_record(tmp_path / "bag", record))
        assert_same(run.record, record)
        assert np.isnan(run.metrics.max_object_displacement_in_grasp_m) != truth
        assert run.bag_metrics.complete

    def test_in_a_namespace(self, tmp_path):
        left, right = random_record(seed=1), random_record(seed=2)
        with RunWriter(tmp_path / "bag") as bag:
            for row in range(len(left)):
                write_tick(bag, left, row, START + row * PERIOD, "/left/")
                write_tick(bag, right, row, START + row * PERIOD, "/right/")
        right.desired_position[:] = right.desired_quaternion[:] = np.nan
        assert_same(Run(tmp_path / "bag", namespace="right").record, right)

    def test_a_message_counts_at_the_tick_of_its_stamp_only(self, tmp_path):
        with RunWriter(tmp_path / "bag") as bag:
            for tick in (0, 10, 20):
                tick_only(bag, tick, tick)
            for stamp in (10, 15, 99):
                bag.write("/grasp_force", force_message((0.0, float(stamp), 0.0), stamp), 21)
        record = Run(tmp_path / "bag").record
        np.testing.assert_array_equal(record.grasp_force, [np.nan, 10.0, np.nan])
        np.testing.assert_array_equal(record.theta, [[1.0, 2.0]] * 3)
        assert np.isnan(record.rates).all() and record.forces.shape == (3, 0, 3)

    def test_repeated_ticks_count_once(self, tmp_path):
        with RunWriter(tmp_path / "bag") as bag:
            for at, tick in enumerate([0, 2, 2, 2, 4]):
                tick_only(bag, tick, at)
        run = Run(tmp_path / "bag")
        assert run.record.stamps.tolist() == [0, 2, 4] and run.bag_metrics.repeated_ticks == 2
        assert run.earlier == []

    def test_no_contact_has_no_frame_either(self, tmp_path):
        record = random_record()
        record.contact_positions[3, 1] = record.contact_positions[4, 2, 0] = np.nan
        seen = Run(write_record(tmp_path / "bag", record)).record
        record.contact_quaternions[3, 1] = np.nan
        assert_same(seen, record)

    def test_joints_may_be_named_in_any_order_and_among_others(self, tmp_path):
        """The first command has those of the hand; a message without one of them is ignored."""
        with RunWriter(tmp_path / "bag") as bag:
            for at, order in enumerate((["b", "a"], ["a", "b"], ["a", "b"])):
                states = joint_message([*order, "wrist"], at, position=[1.0 + at, 5.0, 9.0])
                bag.write("/joint_states", states, at)
                other = ["a", "c"] if at == 2 else ["a", "b"]
                bag.write("/joint_command", joint_message(other, at, effort=[20.0, 10.0]), at)
        record = Run(tmp_path / "bag").record
        assert record.joint_names == ["a", "b"]
        np.testing.assert_array_equal(record.theta, [[5.0, 1.0], [2.0, 5.0], [3.0, 5.0]])
        np.testing.assert_array_equal(record.command, [[20.0, 10.0], [20.0, 10.0], [np.nan] * 2])

    def test_without_commands_the_joints_are_those_of_the_first_state(self, tmp_path):
        with RunWriter(tmp_path / "bag") as bag:
            for at, order in enumerate((["b", "a"], ["a", "b"])):
                bag.write("/joint_states", joint_message(order, at, position=[1.0, 5.0]), at)
        record = Run(tmp_path / "bag").record
        assert record.joint_names == ["b", "a"]
        np.testing.assert_array_equal(record.theta, [[1.0, 5.0], [5.0, 1.0]])

    def test_fingers_may_be_named_in_any_order(self, tmp_path):
        values = {"position": [0.2, 0.1], "velocity": [0.4, 0.3], "effort": [2.0, 1.0]}
        with RunWriter(tmp_path / "bag") as bag:
            tick_only(bag, 0, 0)
            bag.write("/grip_state", joint_message(["finger_2", "finger_1"], 0, **values), 3)
        record = Run(tmp_path / "bag", fingers=["finger_1", "finger_2"]).record
        np.testing.assert_array_equal(record.friction, [[0.1, 0.2]])
        np.testing.assert_array_equal(record.slip_evidence, [[0.3, 0.4]])
        np.testing.assert_array_equal(record.grip, [[1.0, 2.0]])

    def test_fingers_have_the_order_that_is_asked_for_or_that_of_the_scenario(self, tmp_path):
        """Contacts of another number of fingers are unknown."""
        record = random_record()
        said = {"scenario": resolved(load_scenario("paper"))}
        run = Run(write_record(tmp_path / "bag", record, custom_data=said))
        assert run.record.finger_names == ["finger_1", "finger_2", "finger_3"]
        given = Run(tmp_path / "bag", fingers=["finger_3", "finger_1", "finger_2"]).record
        np.testing.assert_array_equal(given.forces, record.forces[:, [2, 0, 1]])
        assert np.isnan(Run(tmp_path / "bag", fingers=["finger_1"]).record.contact_positions).all()
        with pytest.raises(BagError, match="no finger 'finger1', but: finger_1, finger_2, fin"):
            Run(tmp_path / "bag", fingers=["finger1", "finger_2", "finger_3"])

    def test_without_its_scenario_the_fingers_have_the_order_of_the_hand(self, tmp_path):
        """Contacts have no names, and the thumb, which comes first, is not the first by name."""
        record = random_record()
        record.finger_names[:] = ["thumb", "index", "middle"]
        assert_same(Run(write_record(tmp_path / "bag", record)).record, record)

    @pytest.mark.parametrize(
        ("poses", "in_force"),
        [
            ([(0, 1.0)], [1.0] * 5),
            ([(10, 2.0), (30, 3.0)], [-1.0, 2.0, 2.0, 3.0, 3.0]),
            ([(10, 1.0), (10, 2.0)], [-1.0, 2.0, 2.0, 2.0, 2.0]),  # the last one counts
            ([(25, 1.0)], [-1.0, -1.0, -1.0, 1.0, 1.0]),  # its tick is not in the bag
            ([(50, 1.0)], [-1.0] * 5),
        ],
    )
    def test_a_desired_pose_holds_from_its_tick_on(self, poses, in_force, tmp_path):
        """Each pose is given by its effective tick, of 0, 10, 20, 30 and 40 ns, and its x."""
        with RunWriter(tmp_path / "bag") as bag:
            for row in range(5):
                tick_only(bag, 10 * row, 100 + 100 * row)
            for stamp, x in poses:
                accepted = pose_message((x, 0.0, 0.0), STRAIGHT, stamp)
                bag.write("/accepted/desired_pose", accepted, 105 + 10 * stamp)
        found = Run(tmp_path / "bag").record.desired_position[:, 0]
        assert np.nan_to_num(found, nan=-1.0).tolist() == in_force


class TestFolders:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        write_record(tmp_path / "run" / "bag", random_record())
        return tmp_path / "run"

    def test_run_bag_and_file_are_the_same(self, folder):
        (folder.parent / "latest").symlink_to(folder.name)
        bag = folder / "bag"
        for path in (folder, bag, bag / "bag_0.mcap", str(folder.parent / "latest")):
            assert len(Run(path).record) == 20

    def test_scenario_beside_the_bag(self, folder):
        assert Run(folder).scenario is None and Run(folder).metrics.goal_reached is None
        (folder / "scenario.yaml").write_text(resolved(load_scenario("pinch")))
        for path in (folder, folder / "bag"):
            assert Run(path).scenario == load_scenario("pinch")
        assert Run(folder).metrics.goal_reached is False
        (folder / "scenario.yaml").write_text("extends: pinch")
        assert Run(folder).scenario.plant == load_scenario("pinch").plant

    def test_scenario_of_another_version(self, folder):
        (folder / "scenario.yaml").write_text("duratoin: 3.0\n")
        run = Run(folder)
        assert "scenario.yaml: unknown key 'duratoin'" in run.scenario_problem
        assert run.scenario is None and run.metrics.goal_reached is None

    @pytest.mark.parametrize("case", ["unknown", "known", "lost", "other"])
    def test_assumptions_are_those_of_a_hand_that_is_known(self, case, folder, tmp_path):
        """If the hand's file is missing or different, the topics define the fingers."""
        text = resolved(load_scenario("paper"))
        problem = ""
        if case == "lost":
            text = text.replace("hand: paper", "hand: lost/hand.yaml")
            problem = "lost/hand.yaml' does not exist"
        elif case == "other":
            text = text.replace("hand: paper", f"hand: {write_hand(tmp_path, [3, 4, 5])}")
            text = text.replace("layout: three_faces", "layout: ''")
            problem = "other numbers of fingers and joints here"
        if case != "unknown":
            (folder / "scenario.yaml").write_text(text)
        run = Run(folder)
        assert (run.scenario is None) == (case == "unknown") and run.scenario_problem == ""
        assert run.record.finger_names == ["finger_1", "finger_2", "finger_3"]
        assert len(run.assumptions) == (9 if case == "known" else 0)
        assert problem in run.assumptions_problem and bool(problem) == bool(run.assumptions_problem)

    def test_topics_of_another_type_are_refused(self, tmp_path):
        with RunWriter(tmp_path / "bag") as bag:
            tick_only(bag, 0, 0)
            bag.write("/grip_state", pose_message((0.0, 0.0, 0.0), STRAIGHT, 0), 1)
        with pytest.raises(BagError, match=r"/grip_state \(geometry_msgs/msg/PoseStamped\)"):
            Run(tmp_path)

    def test_without_a_bag_or_a_tick(self, tmp_path):
        with pytest.raises(BagError, match="nowhere does not exist"):
            Run(tmp_path / "nowhere")
        (tmp_path / "scenario.yaml").write_text("")
        with pytest.raises(BagError, match="has no folder bag/"):
            Run(tmp_path)
        with RunWriter(tmp_path / "bag") as bag:
            bag.add_channel("/joint_states", "sensor_msgs/msg/JointState")
        with pytest.raises(BagError, match="contains no ticks"):
            Run(tmp_path / "bag")


def test_bag_metrics(tmp_path):
    """Twenty ticks, one of them unanswered and another without k_f."""
    record = random_record()
    with RunWriter(tmp_path / "bag") as bag:
        for row in range(len(record)):
            at = START + row * PERIOD
            if row not in (4, 7):
                write_tick(bag, record, row, at)
                continue
            values = {"position": record.theta[row]}
            stamp = int(record.stamps[row])
            bag.write("/joint_states", joint_message(record.joint_names, stamp, **values), at)
            if row == 7:
                effort = record.command[row]
                answer = joint_message(record.joint_names, stamp, effort=effort)
                bag.write("/joint_command", answer, at + 5 * LATENCY)
    m = Run(tmp_path / "bag").bag_metrics
    assert m.messages == 18 * 18 + 3
    assert m.topics["/joint_states"].complete and not m.complete and m.absent == []
    assert (m.topics["/joint_command"].ticks, m.topics["/grasp_force"].ticks) == (19, 18)
    assert m.topics["/auxiliary_pose"].complete is None
    assert m.ticks_per_second == pytest.approx(1e9 / PERIOD)
    assert m.command_latency_median_s == pytest.approx(1e-9 * LATENCY)
    assert m.command_latency_p99_s == pytest.approx((1.0 + 0.82 * 4.0) * 1e-9 * LATENCY)
    assert m.command_latency_max_s == pytest.approx(5e-9 * LATENCY)
    assert m.topics["/grasp_force"].messages == 18


def test_absent_topics_are_named(tmp_path):
    with RunWriter(tmp_path / "bag") as bag:
        tick_only(bag, 0, 0)
    m = Run(tmp_path / "bag", fingers=["thumb"]).bag_metrics
    of_the_hand = "/joint_command /tactile/contacts /grasp_force /grip_state".split()
    assert m.absent == [*of_the_hand, "/tactile/thumb/wrench", "/optimal_force/thumb"]
    assert not m.complete and np.isnan(m.ticks_per_second)


def test_columns_for_tables(tmp_path):
    record = random_record()
    named = columns(record)
    np.testing.assert_array_equal(named["forces.finger_2.y"], record.forces[:, 1, 1])
    np.testing.assert_array_equal(named["theta.joint_9"], record.theta[:, 8])
    np.testing.assert_array_equal(named["desired_quaternion.w"], record.desired_quaternion[:, 3])
    arrays = [getattr(record, f.name) for f in fields(Record) if f.metadata]
    assert len(named) == sum(array[0].size for array in arrays)


def test_each_reset_begins_a_section_with_its_own_messages(tmp_path):
    """A node may publish a message of a new section just before its first tick is logged."""
    ms = 1_000_000
    with RunWriter(tmp_path / "bag") as bag:
        for section, ticks in enumerate((4, 3, 2)):
            for tick in range(ticks):
                at = START + (1000 * section + 10 * tick) * ms
                grasp_force = force_message((0.0, 10.0 * section + tick, 0.0), tick)
                bag.write("/grasp_force", grasp_force, at - 5 * ms)
                tick_only(bag, tick, at)
    run = Run(tmp_path / "bag")
    sections = [each.record for each in (*run.earlier, run)]
    assert [record.stamps.tolist() for record in sections] == [[0, 1, 2, 3], [0, 1, 2], [0, 1]]
    assert [record.grasp_force.tolist() for record in sections] == [
        [0.0, 1.0, 2.0, 3.0],
        [10.0, 11.0, 12.0],
        [20.0, 21.0],
    ]


def test_time_that_steps_back_a_little_is_disorder_and_no_reset():
    def ticks(*times: float) -> list[int]:
        stamps = [round(1e9 * time) for time in times]
        data = [serialized(joint_message(NAMES, stamp, position=[1.0, 2.0])) for stamp in stamps]
        states = TopicMessages([START + row * PERIOD for row in range(len(data))], data)
        split = sections({"/joint_states": states}, "/joint_states")
        return [len(each["/joint_states"].data) for each in split]

    assert ticks(5.0, 6.0, 5.999, 7.0) == [4]
    assert ticks(5.0, 6.0, 5.0, 7.0) == [4]
    assert ticks(5.0, 6.0, 4.9) == ticks(5.0, 6.0, 0.0) == ticks(0.5, 0.6, 0.0) == [2, 1]


@pytest.mark.parametrize("late", [0, 1])
def test_a_section_ends_a_tenth_of_a_second_before_the_next_begins(late, tmp_path):
    """Later messages belong to the next section."""
    second = 10**9
    with RunWriter(tmp_path / "bag") as bag:
        for at, tick in enumerate((0, 1, 0)):
            tick_only(bag, tick, at * second)
        early = 2 * second - 10**8 - late
        for stamp, at in ((0, 1), (1, second + 1), (0, early)):
            bag.write("/grasp_force", force_message((0.0, float(stamp), 0.0), stamp), at)
        pose = pose_message((3.0, 0.0, 0.0), STRAIGHT, 0)
        bag.write("/accepted/desired_pose", pose, early)
    run = Run(tmp_path / "bag")
    [earlier] = run.earlier
    assert earlier.series["/grasp_force"].stamps.tolist() == ([0, 1, 0] if late else [0, 1])
    np.testing.assert_array_equal(run.record.grasp_force, [np.nan if late else 0.0])
    for one, known in ((earlier, late == 1), (run, late == 0)):
        assert np.isfinite(one.record.desired_position).all() == known


def test_only_the_first_command_behind_a_tick_of_the_last_run_answers_it(tmp_path):
    second, ms = 10**9, 10**6
    with RunWriter(tmp_path / "bag") as bag:
        for section, delays in enumerate(((10, 20, 30), (0, None, 7))):
            for tick, delay in enumerate(delays):
                at = (10 * section + tick) * second
                tick_only(bag, tick, at)
                if delay is not None:
                    for again in (0, 50):
                        answer = joint_message(NAMES, tick, effort=[1.0, 2.0])
                        bag.write("/joint_command", answer, at + (delay + again) * ms)
    run = Run(tmp_path / "bag")
    np.testing.assert_allclose(run.latencies, [0.0, np.nan, 0.007])
    assert run.bag_metrics.command_latency_max_s == pytest.approx(0.007)


def test_a_run_that_a_user_steered_is_not_judged(tmp_path):
    """The summary next to the bag decides; if it cannot be read, the goal applies."""
    write_record(tmp_path / "bag", random_record(3))
    assert not Run(tmp_path).steered
    for text in ('{"interactive": false}', "{}", "[1]", "{"):
        (tmp_path / "summary.json").write_text(text)
        assert not Run(tmp_path).steered, text
    (tmp_path / "summary.json").write_text('{"interactive": true}')
    (tmp_path / "scenario.yaml").write_text(resolved(load_scenario("paper")))
    judged = Run(tmp_path, steered=False)
    assert judged.metrics.goal_reached is False and judged.headline == "goal not reached"
    for path in (tmp_path, tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        finished = Run(path)
        assert finished.folder == tmp_path
        assert finished.metrics.goal_reached is None and finished.headline == "finished"


def test_refusals_of_both_nodes_come_in_the_order_of_their_ticks(tmp_path):
    with RunWriter(tmp_path / "bag") as bag:
        for tick in range(4):
            tick_only(bag, tick, tick)
        late, early = 2 * 10**9 + 3, 10**9 + 5
        for stamp, node in ((late, "manipulation_controller"), (early, "slip_regulator")):
            bag.write(f"/rejected/{node}", request_message(stamp, node, node, "too far"), stamp)
    run = Run(tmp_path / "bag")
    assert [each.text for each in run.events if each.kind == "refusal"] == [
        "slip_regulator is rejected: too far",
        "manipulation_controller is rejected: too far",
    ]
    assert run.requests == []


@pytest.mark.parametrize(
    ("namespace", "prefix"), [("left", "/left/"), ("/left/", "/left/"), ("", "/"), ("/", "/")]
)
def test_the_only_hand_is_found_or_the_one_that_is_chosen(namespace, prefix):
    given = ["/left/joint_states", "/joint_states", "/right/joint_states"]
    assert find_prefix(given, namespace, "bag") == prefix
    assert find_prefix([f"{prefix}joint_states", "/clock"], None, "bag") == prefix


@pytest.mark.parametrize(
    ("topics", "namespace", "found"),
    [
        ("/right/joint_states /left/joint_states", None, "namespaces: left, right; choose one"),
        ("/left/joint_states", "up", "a hand in the namespaces: left; choose one"),
        ("/joint_states_raw /other_joint_states /clock", None, "holds no run of a hand"),
        ("/clock", "left", "holds no run of a hand: it has no joint_states"),
    ],
)
def test_a_hand_that_is_not_clear_is_refused(topics, namespace, found):
    with pytest.raises(BagError, match=found):
        find_prefix(topics.split(), namespace, "bag")


def test_fingers_in_natural_order_and_of_this_hand_only():
    given = [
        "/l/tactile/f10/wrench",
        "/l/optimal_force/f2",
        "/l/ground_truth/f1/wrench",
        "/r/tactile/f3/wrench",
        "/l/tactile/contacts",
    ]
    assert find_fingers(given, "/l/") == ["f1", "f2", "f10"]
