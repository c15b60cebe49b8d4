# SPDX-License-Identifier: Apache-2.0
"""In real time, at the defaults: a hand whose controller dies while it moves keeps the object."""

import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool
from support.graph import Graph
from support.messages import stamp_to_ns

from tactile_hand_ros import names
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR
from tactile_hand_ros.scenario.scenario import load_scenario

SCENARIO = load_scenario(
    "paper",
    {"duration": 86400, "plant.autostart": False, "plant.rate": 200.0, "plant.pacing": "realtime"},
)
P_D = np.array(SCENARIO.targets[0].position)


def holds(graph: Graph) -> bool:
    """Return whether the plant reports a hold as an error, whatever its reason was first."""
    return graph.says("plant", "mode", "holding") and graph.health["/plant"].level == ERROR


def last_tick(graph: Graph) -> int:
    """Return the tick of the plant's last report [ns]."""
    return int(graph.health["/plant"].values["tick_ns"])


def test_a_killed_controller_in_real_time_costs_no_object(domain, tmp_path):
    with Graph(SCENARIO, domain, tmp_path) as graph:
        told, known = list[Bool](), list[DiagnosticArray]()
        requests, hear = names.accepted_requests(names.CONTROLLER), graph.node.create_subscription
        hear(Bool, names.JOINT_HOLD, told.append, qos.latched_qos())
        hear(DiagnosticArray, requests, known.append, qos.USER_DEPTH)
        graph.begin(P_D)
        start = graph.position()
        graph.wait(lambda: np.linalg.norm(graph.position() - start) > 0.02, "the motion")
        graph.kill("manipulation_controller")
        killed = stamp_to_ns(graph.newest(names.JOINT_STATES).header.stamp)
        graph.wait(lambda: holds(graph) and last_tick(graph) > killed, "the plant's word")
        tick = last_tick(graph)
        graph.wait(
            lambda: stamp_to_ns(graph.newest(names.OBJECT_POSE).header.stamp) >= tick,
            "the pose at the word, not an older one",
        )
        for word, bound in (("its stop", 0.003), ("the hold", 0.001)):
            at, until = graph.position(), graph.time + 1.0
            graph.wait(lambda end=until: graph.time > end, word)
            assert np.linalg.norm(graph.position() - at) < bound, word
        assert np.linalg.norm(P_D - at) > 0.02
        assert np.isfinite(graph.contacts).all()
        assert 8.0 < graph.forces[:, 1].sum() < 48.0
        assert told[-1].data
        graph.kill("tactile_sensor")  # so that no answer ends the hold before it is known
        graph.start("manipulation_controller")
        graph.wait(lambda: graph.hears("manipulation_controller", names.JOINT_HOLD), "its reader")
        graph.start("tactile_sensor")
        graph.wait(lambda: graph.says("plant", "mode", "running"), "commands")
        graph.wait(lambda: graph.hears("manipulation_controller", "desired_pose"), "its readiness")
        graph.desire(P_D)
        graph.wait(lambda: np.linalg.norm(graph.position() - at) > 0.02, "the motion")
        assert np.isfinite(graph.contacts).all()
        graph.wait(lambda: not told[-1].data, "the end of the hold")
        # The new controller was told at once.
        assert names.JOINT_HOLD in [message.status[0].message for message in known]
        assert set(graph.end(signal.SIGINT).values()) == {0}
