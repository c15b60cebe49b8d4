# SPDX-License-Identifier: Apache-2.0
"""What the executor does with errors, turns and coroutines, step by step, without a thread."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import executor as module
from tactile_hand_ros.ros.direct_take import DirectTakeGroup
from tactile_hand_ros.ros.executor import (
    Ready,
    SurvivingExecutor,
    WaitSetExecutor,
    is_supported,
    spin,
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
    ("name", "missing"),
    [(name, method) for name, methods in module._NEEDED.items() for method in methods.split()]
    + [("Nothing", "at_all")],
)
def test_each_missing_piece_is_noticed(
    monkeypatch: pytest.MonkeyPatch, name: str, missing: str
) -> None:
    assert is_supported()
    needed = {**module._NEEDED, name: f"{module._NEEDED.get(name, '')} {missing}_of_another_rclpy"}
    monkeypatch.setattr(module, "_NEEDED", needed)
    assert not is_supported()


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


def fail(error: BaseException) -> Any:
    def failing(*_: Any, **__: Any) -> Any:
        raise error

    return failing


def test_what_a_service_throws_concerns_all_nodes_that_survive(
    executor: Any, nodes: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SingleThreadedExecutor, "spin_once", fail(ValueError("odd")))
    executor.spin_once(0)
    for node in nodes[:2]:
        assert node.survived == [("services", "ValueError", "odd")]
    for end in (ExternalShutdownException(), ShutdownException()):
        monkeypatch.setattr(SingleThreadedExecutor, "spin_once", fail(end))
        with pytest.raises(type(end)):
            executor.spin_once(0)
    assert len(nodes[0].survived) == 1


def test_an_error_that_no_node_survives_is_raised(context: Any, nodes: list[Any]) -> None:
    alone = SurvivingExecutor(context=context)
    alone.add_node(nodes[2])
    with pytest.raises(ValueError, match="odd"):
        alone._survive("x", ValueError("odd"))
    alone.remove_node(nodes[2])
    alone.shutdown()


def test_bytes_that_cannot_be_read_concern_their_owner(
    executor: Any, nodes: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "its bytes cannot be read (ValueError)."
    service = SimpleNamespace(srv_name="/b/ask")
    monkeypatch.setattr(Survivor, "services", property(lambda s: [service] * (s is nodes[1])))
    monkeypatch.setattr(SingleThreadedExecutor, "_take_service", fail(ValueError("odd")))
    assert executor._take_service(service) is None
    assert nodes[1].survived == [("/b/ask", MessageError.__name__, text)]
    subscription = SimpleNamespace(topic_name="/a/x")
    monkeypatch.setattr(
        Survivor, "subscriptions", property(lambda s: [subscription] * (s is nodes[0]))
    )
    monkeypatch.setattr(SingleThreadedExecutor, "_take_subscription", fail(ValueError("odd")))
    assert executor._take_subscription(subscription) is None
    assert nodes[0].survived == [("/a/x", MessageError.__name__, text)]
    assert len(nodes[1].survived) == 1
    monkeypatch.setattr(SingleThreadedExecutor, "_take_subscription", lambda *_: "good")
    monkeypatch.setattr(SingleThreadedExecutor, "_take_service", lambda *_: "good")
    assert executor._take_subscription(subscription) == executor._take_service(service) == "good"
    monkeypatch.undo()


@pytest.fixture
def own(context: Any) -> Iterator[WaitSetExecutor]:
    made = WaitSetExecutor(context=context)
    yield made
    made.shutdown()


class Queue:
    """A subscription that holds so many messages."""

    def __init__(self, count: int, *, info: bool = False) -> None:
        self.left, self.got = count, list[Any]()
        self.handle, self.msg_type, self.raw = self, int, True
        kinds = Subscription.CallbackType
        self._callback_type = kinds.WithMessageInfo if info else kinds.MessageOnly
        self.result: Any = None

    def take_message(self, kind: Any, raw: bool) -> Any:
        assert (kind, raw) == (int, True)
        if not self.left:
            return None
        self.left -= 1
        if self.left == 5:
            raise ValueError("odd")
        return self.left, {"number": self.left}

    def callback(self, *args: Any) -> Any:
        self.got.append(args)
        return self.result


def test_a_hundred_messages_are_a_turn_and_what_cannot_be_read_is_refused(
    own: WaitSetExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[Any] = []
    monkeypatch.setattr(own, "_refuse", lambda *args: refused.append(args[0]))
    own._stale = False
    flood, few = Queue(250), Queue(8, info=True)
    own._drain(flood)  # type: ignore[arg-type]
    assert len(flood.got) == 100 and flood.left == 150 and flood.got[0] == (249,)
    own._drain(few)  # type: ignore[arg-type]
    assert few.left == 0 and refused == [few]
    assert few.got[:2] == [(7, {"number": 7}), (6, {"number": 6})] and len(few.got) == 7
    own._stale = True
    own._drain(flood)  # type: ignore[arg-type]
    assert flood.left == 150


def test_coroutines_are_left_to_the_public_executor(
    own: WaitSetExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    created: list[Any] = []
    monkeypatch.setattr(own, "create_task", created.append)

    async def later() -> None: ...

    coroutine = later()
    for result in (None, 5, coroutine):
        own._finish(result)
    assert created == [coroutine]
    coroutine.close()


def test_what_waits_for_the_end_of_reading_is_called_once(own: WaitSetExecutor) -> None:
    calls: list[int] = []
    own.after_reading(lambda: calls.append(1))
    own.after_reading(lambda: calls.append(2) or own.after_reading(lambda: calls.append(3)))
    own._call_afterwards()
    assert calls == [1, 2]
    own._call_afterwards()
    own._call_afterwards()
    assert calls == [1, 2, 3]


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


class Entities:
    """What a wait finds."""

    def __init__(self, *found: Ready) -> None:
        self.found, self.limits = list(found), list[int]()

    def wait(self, limit: int) -> Ready:
        self.limits.append(limit)
        return self.found.pop(0)


def timer(calls: list[str], name: str, *, ready: bool = True) -> Any:
    handle = SimpleNamespace(
        is_timer_ready=lambda: ready, call_timer=lambda: calls.append(f"call {name}")
    )
    return SimpleNamespace(handle=handle, callback=lambda: calls.append(name))


def test_guards_timers_and_messages_are_served_in_this_order_and_then_what_is_rare(
    own: WaitSetExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    guard = SimpleNamespace(callback=lambda: calls.append("guard"))
    silent = SimpleNamespace(callback=None)
    monkeypatch.setattr(own, "_drain", calls.append)
    monkeypatch.setattr(own, "spin_once", lambda timeout_sec: calls.append(f"rare {timeout_sec}"))
    own.after_reading(lambda: calls.append("read"))
    timers = [timer(calls, "t1"), timer(calls, "t2", ready=False)]
    ready = Ready([silent, guard], timers, ["s1", "s2"], True)  # type: ignore[list-item]
    own._stale = False
    entities: Any = Entities(ready, Ready([], [], []), Ready([], [], [], True))
    own._step(entities, 1_000_000_000)
    assert calls == ["guard", "call t1", "t1", "s1", "s2", "read", "rare 0"]
    own._step(entities, 1_000_000_000)
    assert len(calls) == 7 and entities.limits == [1_000_000_000] * 2
    own._stale = True
    own._step(entities, 0)
    assert len(calls) == 7 and entities.limits[-1] == 0  # nothing while entities have changed


def test_when_it_is_to_end_the_guard_that_woke_it_ends_the_round(
    own: WaitSetExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    guard = SimpleNamespace(callback=lambda: calls.append("guard"))
    monkeypatch.setattr(own, "_is_running", lambda: False)
    own._stale = False
    entities: Any = Entities(Ready([guard], [timer(calls, "t")], []))
    own._step(entities, 0)
    assert calls == [] and own._stale


def test_while_a_coroutine_is_suspended_the_public_executor_works(
    own: WaitSetExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[float] = []
    monkeypatch.setattr(own, "spin_once", lambda timeout_sec: limits.append(timeout_sec))
    task = SimpleNamespace(done=lambda: False)
    own._tasks = [(task, None, None)]
    own._stale = False
    own._step(Entities(), 1_000_000_000)  # type: ignore[arg-type]
    assert limits == [1.0] and own._stale
    task.done = lambda: True
    own._step(Entities(Ready([], [], [])), 0)  # type: ignore[arg-type]
    assert len(limits) == 1
    own._tasks = []


def test_nodes_that_come_and_go_make_it_wait_for_other_things(
    own: WaitSetExecutor, nodes: list[Any]
) -> None:
    for change in (
        lambda: own.add_node(nodes[0]),
        lambda: own.wake(),
        lambda: own.remove_node(nodes[0]),
    ):
        own._stale = False
        change()
        assert own._stale
    assert own.add_node(nodes[0]) and not own.add_node(nodes[0])
    own.remove_node(nodes[0])


def test_one_node_or_several_are_served_until_the_context_ends(
    context: Any, nodes: list[Any]
) -> None:
    for served in (nodes[0], nodes[:2]):
        calls: list[str] = []

        class Noted(SurvivingExecutor):
            """Notes whom it serves."""

            def spin(self) -> None:
                calls.append(",".join(sorted(node.get_name() for node in self.get_nodes())))
                raise ExternalShutdownException

        made = Noted(context=context)
        spin(served, made)
        assert calls == ["a" if served is nodes[0] else "a,b"]
        assert made.get_nodes() == [] and made._is_shutdown


def test_no_executor_serves_what_is_taken_directly() -> None:
    group = DirectTakeGroup()
    assert not group.can_execute(None) and not group.beginning_execution(None)
