# SPDX-License-Identifier: Apache-2.0
"""What the executor does with errors, turns and coroutines, step by step, without a thread."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.subscription import Subscription

from tactile_hand_ros.ros import executor as module
from tactile_hand_ros.ros.direct_take import DirectTakeGroup
from tactile_hand_ros.ros.executor import (
    SurvivingExecutor,
    WaitSetExecutor,
    is_supported,
)
from tactile_hand_ros.ros.middleware import isolated_domain, private_context


class Survivor(Node):
    """A node that notes what it survives."""

    def __init__(self, name: str, context: Any) -> None:
        super().__init__(name, context=context, start_parameter_services=False)
        self.survived: list[tuple[str, str, str]] = []

    def survive(self, source: str, error: Exception) -> None:
        self.survived.append((source, type(error).__name__, str(error)))


@pytest.fixture
def context() -> Iterator[Any]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture
def nodes(context: Any) -> Iterator[list[Any]]:
    made = [Survivor("a", context), Survivor("b", context)]
    made.append(Node("plain", context=context, start_parameter_services=False))
    yield made
    for node in made:
        node.destroy_node()


@pytest.fixture(params=[WaitSetExecutor, SurvivingExecutor])
def executor(request: pytest.FixtureRequest, context: Any, nodes: list[Any]) -> Iterator[Any]:
    made = request.param(context=context)
    for node in nodes:
        made.add_node(node)
    yield made
    for node in nodes:
        made.remove_node(node)
    made.shutdown()


@pytest.mark.parametrize(
    "piece", ["_take_service", "_take_subscription", "_guard", "_is_shutdown", "CallbackType"]
)
def test_without_a_piece_of_rclpy_the_own_loop_is_not_used(
    monkeypatch: pytest.MonkeyPatch, piece: str, context: Any
) -> None:
    if piece.startswith("_take"):
        monkeypatch.delattr(module.Executor, piece)
    elif piece == "CallbackType":
        monkeypatch.delattr(Subscription, piece)
    else:
        source = module.inspect.getsource(module.Executor.__init__).replace(f"self.{piece}", "x")
        real = module.inspect.getsource
        monkeypatch.setattr(
            module.inspect,
            "getsource",
            lambda what: source if what is module.Executor.__init__ else real(what),
        )
    assert not is_supported()
    made = module.make_executor(context)
    assert type(made) is SurvivingExecutor
    monkeypatch.undo()
    made.shutdown()


def test_nodes_work_between_messages_as_long_as_there_is_something_to_do(
    executor: Any, nodes: list[Any]
) -> None:
    """A timer gets its turn meanwhile; then the executor waits."""
    counts = {"work": 0, "timer": 0}

    def work() -> bool:
        counts["work"] += 1
        return counts["work"] < 1000

    def on_timer() -> None:
        counts["timer"] += 1
        if counts["work"] >= 1000:
            executor.shutdown(timeout_sec=0)

    nodes[0].work = work
    nodes[2].create_timer(0.001, on_timer)
    executor.spin()
    assert counts["work"] >= 1000 and counts["timer"] > 0


def test_no_executor_serves_what_is_taken_directly() -> None:
    group = DirectTakeGroup()
    assert not group.can_execute(None) and not group.beginning_execution(None)
