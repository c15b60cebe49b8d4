# SPDX-License-Identifier: Apache-2.0
"""What users asked of a hand besides poses and squeezes: service calls, and what was refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.run.alignment import in_last_run
from tactile_hand_ros.run.series import Series

OPENING = ("grasp", "false")
"""Service and value of the call that lets go of the object."""


class Asked(NamedTuple):
    """Something that a node accepted or refused.

    Attributes:
        stamp: The first tick that it could change, or the last one before it was refused, ns.
        key: The service, or the topic of the refused command.
        value: The value of the request as text, or why it was refused.
    """

    stamp: int
    key: str
    value: str


def read_asked(bag: Path, topic: str, states: Series, stop: int | None = None) -> list[Asked]:
    """Read an `accepted/<node>/requests` or `rejected/<node>` of the last run in a bag.

    Args:
        bag: The bag.
        topic: The topic, in full.
        states: The topic `joint_states`.
        stop: Log time at which to end, ns.

    Raises:
        BagError: If the bag cannot be read.
    """
    messages = list(read_messages(bag, [topic], stop=stop))
    log_times = np.array([log_time for _, log_time, _ in messages], dtype=np.int64)
    stamps = np.array([_ns(message.header.stamp) for _, _, message in messages], dtype=np.int64)
    counts = np.flatnonzero(in_last_run(Series(log_times, stamps, []), states))
    pairs = [message.status[0].values[0] for _, _, message in messages]
    return [Asked(int(stamps[i]), pairs[i].key, pairs[i].value) for i in counts]


def releases(requests: Sequence[Asked]) -> list[float]:
    """Return when the hand was asked to open, s, without what a later grasp has ended."""
    found: list[float] = []
    for each in requests:
        if each.key == OPENING[0]:
            found = [1e-9 * each.stamp] if each.value == OPENING[1] else []
    return found


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
