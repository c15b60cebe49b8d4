# SPDX-License-Identifier: Apache-2.0
"""The collector rests between ticks, collects in a pause, and cannot let garbage grow forever."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.ros.realtime.garbage import MOST_NEW, CollectionClock, GarbageRest
from tactile_hand_ros.scenario.scenario import load_scenario


@pytest.fixture
def rest() -> Iterator[GarbageRest]:
    """The collector of this process at rest; afterwards as before."""
    made = GarbageRest()
    made.begin()
    yield made
    gc.unfreeze()
    gc.enable()


class Cycle:
    """Something that only the collector frees."""

    def __init__(self) -> None:
        self.own = self


def test_nothing_is_collected_until_it_is_tidied_in_a_pause(rest: GarbageRest) -> None:
    for _ in range(2000):
        Cycle()
    assert gc.get_count()[0] >= 2000
    rest.tidy(is_idle=False)
    assert rest.collections == 0
    rest.tidy(is_idle=True)
    assert (rest.collections, rest.forced) == (1, 0)
    assert gc.get_count()[0] < 500


def test_growth_without_a_pause_has_a_bound(rest: GarbageRest) -> None:
    kept = [[] for _ in range(MOST_NEW + 1)]  # type: ignore[var-annotated]
    rest.tidy(is_idle=False)
    assert (rest.forced, len(kept)) == (1, MOST_NEW + 1)
    shown: dict[str, object] = {}
    rest.report(shown.__setitem__)
    assert shown == {"garbage_collections": 1, "garbage_collections_forced": 1}


def test_a_tick_leaves_nothing_for_the_collector(rest: GarbageRest) -> None:
    """Reference counting suffices: cones, noise and slip prevention make no cycles."""
    loop = ClosedLoop(load_scenario("pull"))
    hand = loop.plant.hand
    record = Record.empty(300, hand.finger_names, hand.joint_names)
    for row in range(100):
        loop.tick(record, row)
    before = gc.get_count()[0]
    for row in range(100, 300):
        loop.tick(record, row)
    assert gc.get_count()[0] - before < 50


def test_the_time_of_collections_is_summed_up() -> None:
    clock = CollectionClock()
    try:
        gc.collect()
        assert clock.seconds > 0.0
    finally:
        clock.close()
    before = clock.seconds
    gc.collect()
    assert clock.seconds == before
