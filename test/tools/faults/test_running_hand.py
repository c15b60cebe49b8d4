# SPDX-License-Identifier: Apache-2.0
"""A campaign gets its answers from nodes that have just been started again."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger
from support.nodes import spinning

from bench.processes import isolated_domain
from studies.faults import running_hand as module
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import load_scenario


def test_a_request_that_a_dead_server_took_with_it_is_sent_again(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_AGAIN", 0.05)
    hand = module.RunningHand(load_scenario("paper"), tmp_path, composed=False)

    def answer(_: Any, response: Any) -> Any:
        response.message = "back at the start"
        return response

    with isolated_domain() as domain, ros_context(domain=domain) as context:
        hand.node, server = Node("campaign", context=context), Node("plant", context=context)
        service = server.create_service(Trigger, "reset", answer)
        with ThreadPoolExecutor() as pool, spinning(hand.node):
            asked = pool.submit(hand._call, Trigger, "reset", Trigger.Request())
            with service.handle:
                wait_until(lambda: service.handle.service_take_request(Trigger.Request)[1])
            with spinning(server):
                assert asked.result(10.0).message == "back at the start"
        hand.node.destroy_node()
        server.destroy_node()
