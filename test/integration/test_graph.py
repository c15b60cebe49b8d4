# SPDX-License-Identifier: Apache-2.0
"""The five nodes as processes over real DDS give the numbers of the in-process loop, to the bit."""

import signal
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from support.graph import TICK_TOPICS, Graph
from support.messages import encoded
from support.recorded import assert_same
from visualization_msgs.msg import MarkerArray

from bench.processes import start_executable
from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.ros import qos
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

NOISE = {"tactile_sensor.location_noise": 1e-4, "tactile_sensor.force_noise": 0.05}
P_D = load_scenario("paper").targets[0].position
RECORDED = [*TICK_TOPICS, names.ACCEPTED_POSE]


def short(name: str = "paper", **changes: object) -> Scenario:
    """Return a scenario of 300 ticks that waits for its start, and for a slow computer."""
    common = {"duration": 0.6, "plant.autostart": False, "plant.command_timeout": 60.0}
    return load_scenario(name, {**common, **changes})


def record(graph: Graph, output: Path) -> Path:
    """Run from the start to the end with a recorder."""
    wanted = ",".join(f"'{graph.full(topic)}'" for topic in RECORDED)
    flags = ("-p", f"output:={output}", "-p", f"topics:=[{wanted}]")
    graph.health.pop("/recorder", None)
    graph.wait_for_readers()
    with start_executable("recorder", "--ros-args", *flags) as recorder:
        for topic in RECORDED:
            graph.wait(lambda t=topic: graph.hears("recorder", t), f"the recorder on {topic}")
        graph.wait_for_readers()
        graph.begin(*[target.position for target in graph.scenario.targets])
        graph.finish()
        recorder.send(signal.SIGINT)
        assert recorder.wait() == 0, recorder.stderr
    return output


def payloads(bag: Path) -> dict[str, list[bytes]]:
    """Return the bytes of every topic, a tick that was sent again counted once."""
    found: dict[str, list[bytes]] = {}
    for message in read_messages(bag, [f"/{topic}" for topic in TICK_TOPICS]):
        found.setdefault(message.topic, []).append(message.data)
    return {topic: [data for data, _ in groupby(sent)] for topic, sent in found.items()}


def assert_same_ticks(recorded: Record, expected: Record) -> None:
    """Compare, to the bit, everything that ticks carry, which is all but the palm's pose."""
    assert_same(recorded, replace(expected, palm=recorded.palm))


def test_the_graph_gives_the_numbers_of_the_in_process_loop(domain, tmp_path):
    """With noise and, in the same processes, without; a killed one would leave no locked memory."""
    with Graph(short(**NOISE), domain, tmp_path) as graph:
        bags = [record(graph, tmp_path / "noisy")]
        for key in NOISE:
            assert graph.set_parameter(*key.split("."), 0.0).successful
        bags.append(record(graph, tmp_path / "quiet"))
        for process in graph.processes.values():
            assert "/dev/shm/fastrtps" not in Path(f"/proc/{process.pid}/maps").read_text()
        assert set(graph.end(signal.SIGTERM).values()) == {0}
    estimates = {names.GRIP_MARGIN, *(names.load(f"finger_{i}") for i in (1, 2, 3))}
    for bag, noise in zip(bags, (NOISE, {}), strict=True):
        expected = ClosedLoop(short(**noise)).run()
        assert_same_ticks(Run(bag).record, expected)
        found, held = payloads(bag), encoded(expected)
        assert {topic: found[topic] for topic in held} == held
        assert found.keys() - held.keys() == {f"/{each}" for each in estimates}  # not in a record


def test_what_slips_is_held_as_in_process(domain, tmp_path):
    """Weight, a noisy skin, a sudden pull: slip, friction, k_f and reshaped f* are the same."""
    pull = {"kind": "step", "start": 0.3, "force": [0.0, 0.0, -14.0]}  # more than the reserve
    slippery = {"plant.disturbances": [pull], "plant.object.friction": 0.25}
    scenario = short("pull", **slippery)
    with Graph(scenario, domain, tmp_path) as graph:
        recorded = Run(record(graph, tmp_path / "bag")).record
    expected = ClosedLoop(scenario).run()
    assert_same_ticks(recorded, expected)
    assert (expected.grip == ContactState.SLIP).any(axis=0).all()
    assert (expected.true_slid[-1] > 1e-5).all() and (expected.friction[-1] < 0.39).all()
    assert expected.grasp_force[-1] > 3.0 * expected.grasp_force[0]


def test_an_imu_and_a_skin_too_late_to_be_believed_cost_no_tick(domain, tmp_path):
    """For 20 ms nothing is felt although the motors press; time waits for the controller's hold."""
    turns = [{"time": 0.5, "rotation": [0.2, 0.0, 0.1]}]
    late = {"tactile_sensor.latency": 0.02, "plant.palm_motion": turns, "duration": 0.2}
    scenario = short("forearm", **late)
    with Graph(scenario, domain, tmp_path) as graph:
        recorded = Run(record(graph, tmp_path / "bag")).record
    assert_same_ticks(recorded, ClosedLoop(scenario).run())


def test_two_hands_in_one_domain_do_not_disturb_each_other(domain, tmp_path):
    """Another layout, target and rate; each ends where its own in-process loop ends.

    The left one is wrongly calibrated, with longer links, larger tips and turned skins, so that its
    sensor reads joints. A viewer shows it in frames of its own.
    """
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
    errors = {"link_lengths": 1.02, "tip_radii": 1.05, "skin_rotation": [0.01, -0.02, 0.03]}
    left = short(duration=0.3, **{f"calibration.{key}": value for key, value in errors.items()})
    right = short("pinch", **{"duration": 0.4, "plant.rate": 250.0})
    with (
        Graph(left, domain, tmp_path / "left", "/left") as one,
        Graph(right, domain, tmp_path / "right", "/right") as other,
        start_executable("viewer", "--ros-args", "-r", "__ns:=/left") as viewer,
    ):
        shown: list[MarkerArray] = []
        one.node.create_subscription(MarkerArray, "/left/markers", shown.append, qos.USER_DEPTH)
        for name in (names.OBJECT_POSE, names.CONTACTS):
            one.wait(lambda n=name: one.hears("viewer", n), f"the viewer on {name}")
        for graph in (one, other):
            graph.begin(P_D)
        for graph in (one, other):
            assert graph.finish().message == f"finished at {graph.scenario.duration:g} s"
            expected = ClosedLoop(graph.scenario).run()
            joints = graph.newest(names.JOINT_STATES)
            np.testing.assert_array_equal(joints.position, expected.theta[-1])
            apart = np.linalg.norm(expected.contact_positions - expected.true_positions, axis=2)
            assert (apart.min() > 1e-3) == (graph is one)
            assert graph.node.count_publishers(graph.full("clock")) == 1
        assert one.node.count_publishers("/clock") == 0

        def is_shown() -> bool:
            objects = [m.pose.position for m in shown[-1].markers if m.ns == "object"]
            return [[p.x, p.y, p.z] for p in objects] == [list(one.position())]

        one.wait(is_shown, "the markers of the left hand")
        viewer.send(signal.SIGINT)
        assert viewer.wait() == 0, viewer.stderr
