# SPDX-License-Identifier: Apache-2.0
"""What waits for a subscription, and in which form its callback gets it."""

from __future__ import annotations

import threading
from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import Float64

from tactile_hand_ros.ros.direct.delivery import DirectDelivery
from tactile_hand_ros.ros.direct.inbox import Inbox, Tap, history_depth

KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


def subscription(depth: int = 2, *, raw: bool = True, info: bool = False, **own: Any) -> Any:
    got: list[Any] = []
    kinds = Subscription.CallbackType
    parts = {
        "topic_name": "/x",
        "msg_type": Float64,
        "raw": raw,
        "qos_profile": QoSProfile(depth=depth),
        "callback": lambda *args: got.append(args),
        "_callback_type": kinds.WithMessageInfo if info else kinds.MessageOnly,
        "got": got,
    }
    return SimpleNamespace(**{**parts, **own})


@pytest.mark.parametrize(
    ("profile", "depth"),
    [(QoSProfile(depth=7), 7), (QoSProfile(depth=1), 1), (QoSProfile(depth=0), 1)],
)
def test_a_history_holds_at_least_one_message(profile: QoSProfile, depth: int) -> None:
    assert history_depth(profile) == depth and history_depth(KEEP_ALL) is None


def test_the_oldest_message_gives_way_and_each_waits_once() -> None:
    waiting: deque[Inbox] = deque()
    wanted = subscription(2)
    inbox = Inbox(wanted, waiting)
    assert inbox.topic == "/x" and inbox.deliver() is None
    for data in (b"1", b"2", b"3"):
        inbox.put(data)
    assert list(waiting) == [inbox, inbox]
    inbox.deliver()
    assert wanted.got == [(b"2",)]
    inbox.put(b"4")
    inbox.clear()
    assert inbox.deliver() is None and len(wanted.got) == 1


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("info", [True, False])
def test_a_callback_gets_bytes_or_a_message_and_what_is_known_of_it(raw: bool, info: bool) -> None:
    wanted = subscription(raw=raw, info=info)
    inbox = Inbox(wanted, deque())
    inbox.put(bytes(serialize_message(Float64(data=2.5))))
    inbox.deliver()
    ((message, *more),) = wanted.got
    assert isinstance(message, bytes) if raw else message == Float64(data=2.5)
    assert len(more) == info
    for known in more:
        assert known["source_timestamp"] == known["received_timestamp"] > 10**18
        assert known["publication_sequence_number"] is None
        assert known["reception_sequence_number"] is None


def test_a_tap_is_called_at_once() -> None:
    wanted = subscription()
    tap = Tap(wanted)
    tap.put(b"1")
    tap.clear()
    assert wanted.got == [(b"1",)] and (tap.topic, tap.subscription) == ("/x", wanted)


def test_messages_are_delivered_in_rounds_and_results_are_passed_on() -> None:
    delivery, finished = DirectDelivery(), list[Any]()
    answers = subscription(9, callback=lambda data: inbox.put(b"again") or data)
    inbox = Inbox(answers, delivery._waiting)
    assert not delivery
    inbox.put(b"first")
    inbox.put(b"second")
    delivery.deliver(finished.append)
    assert finished == [b"first", b"second"] and len(delivery._waiting) == 2
    silent = Inbox(subscription(), delivery._waiting)
    delivery._waiting.clear()
    silent.put(b"x")
    delivery.deliver(finished.append)
    assert len(finished) == 2 and not delivery


def test_only_another_thread_has_to_wake_the_one_that_delivers() -> None:
    delivery, woken = DirectDelivery(), list[str]()
    other = threading.Thread(target=delivery.note)
    other.start()
    other.join()  # nothing to wake yet
    delivery.serve(lambda: woken.append("wake"))
    delivery.note()
    assert woken == []
    other = threading.Thread(target=delivery.note)
    other.start()
    other.join()
    assert woken == ["wake"]
    delivery.when_at_rest(lambda: woken.append("a"))
    delivery.when_at_rest(lambda: woken.append("b"))
    delivery.rest()
    delivery.rest()
    assert woken == ["wake", *"abab"]


class Publisher:
    """A publisher that matches by name, and what is linked to it."""

    def __init__(self, matches: bool) -> None:
        self._matches, self.inboxes, self.joined = matches, list[Any](), list[Any]()

    def join(self, noted: Any, forget: Any) -> None:
        self.joined += [noted, forget]

    def matches(self, inbox: Any) -> bool:
        return self._matches

    def link(self, inbox: Any) -> None:
        self.inboxes.append(inbox)

    def unlink(self, inbox: Any) -> None:
        self.inboxes.remove(inbox)


def test_publishers_and_subscriptions_meet_in_any_order() -> None:
    delivery, met = DirectDelivery(), list[Any]()
    delivery.when_published(met.append)
    before, never, after = Publisher(True), Publisher(False), Publisher(True)
    first, second = (subscription(callback_group=None) for _ in range(2))
    delivery.add_publisher(before)  # type: ignore[arg-type]
    delivery.add_subscription(first)
    delivery.add_subscription(second)
    for late in (never, after):
        delivery.add_publisher(late)  # type: ignore[arg-type]
    assert met == [before, never, after] and before.joined == [
        delivery.note,
        delivery.remove_publisher,
    ]
    for each in (before, after):
        assert [inbox.subscription for inbox in each.inboxes] == [first, second]
    assert never.inboxes == [] and delivery.publisher_count(first) == 2
    before.inboxes[0].put(b"1")
    never.unlink = lambda inbox: None  # type: ignore[method-assign]
    delivery.remove_subscription(first)
    assert [inbox.subscription for inbox in after.inboxes] == [second]
    delivery.deliver(met.append)
    assert first.got == [] and delivery.publisher_count(first) == 0
    delivery.remove_publisher(after)  # type: ignore[arg-type]
    assert delivery.publisher_count(second) == 1
