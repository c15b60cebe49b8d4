# SPDX-License-Identifier: Apache-2.0
"""Completeness and timing of a bag: topics, throughput and command latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.run.reading import HandTopics, Series, first_ticks

# Users may send commands at any time; a holding hand does not publish its auxiliary pose.
_NOT_EVERY_TICK = (names.ACCEPTED_POSE, names.ACCEPTED_FORCE, names.AUXILIARY_POSE, names.IMU)


@dataclass(frozen=True)
class TopicCount:
    """Messages of a topic, ticks with one, and whether all ticks have one; None if not required."""

    messages: int
    ticks: int
    complete: bool | None


@dataclass(frozen=True)
class BagMetrics:
    """Completeness and timing of a bag, by its log times."""

    messages: int  # on all topics of the bag
    topics: Mapping[str, TopicCount]  # those of the hand by full name
    absent: list[str]  # missing topics of the hand; ground truth may be absent
    complete: bool  # whether every tick has a message on each required topic
    repeated_ticks: int  # how often a tick was resent because a reply was late
    ticks_per_second: float  # of wall time
    command_latency_median_s: float  # from a tick to the command that answers it
    command_latency_p99_s: float
    command_latency_max_s: float


def bag_metrics(series: Mapping[str, Series], topics: HandTopics, messages: int) -> BagMetrics:
    """Measure a bag that holds `messages` messages on all topics."""
    states = series[topics.full(names.JOINT_STATES)]
    ticks, logged = first_ticks(states)
    free = {topics.full(name) for name in _NOT_EVERY_TICK}
    counts = {}
    for topic, one in series.items():
        if len(one):
            covered = int(np.isin(ticks, one.stamps).sum())
            complete = None if topic in free else covered == len(ticks)
            counts[topic] = TopicCount(len(one), covered, complete)
    truth = topics.full("ground_truth/")
    absent = [t for t in series if t not in counts and t not in free and not t.startswith(truth)]
    wall = 1e-9 * float(logged[-1] - logged[0])
    latency = latencies(series, topics)
    latency = latency[~np.isnan(latency)]
    median, p99, longest = np.percentile(latency, [50, 99, 100]) if len(latency) else [np.nan] * 3
    return BagMetrics(
        messages=messages,
        topics=counts,
        absent=absent,
        complete=not absent and all(c.complete is not False for c in counts.values()),
        repeated_ticks=int((np.diff(states.stamps) == 0).sum()),
        ticks_per_second=(len(ticks) - 1) / wall if wall > 0.0 else np.nan,
        command_latency_median_s=float(median),
        command_latency_p99_s=float(p99),
        command_latency_max_s=float(longest),
    )


def latencies(series: Mapping[str, Series], topics: HandTopics) -> Array:
    """Return the wall time [s] from each tick to its first command, shape (n,); NaN without one."""
    ticks, logged = first_ticks(series[topics.full(names.JOINT_STATES)])
    command = series[topics.full(names.JOINT_COMMAND)]
    stamps, first = np.unique(command.stamps, return_index=True)
    _, at_tick, at_command = np.intersect1d(ticks, stamps, return_indices=True)
    out = np.full(len(ticks), np.nan)
    out[at_tick] = 1e-9 * (command.log_times[first][at_command] - logged[at_tick])
    return out
