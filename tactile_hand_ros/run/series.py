# SPDX-License-Identifier: Apache-2.0
"""The topics of a hand as arrays, one row a message, in the order in which they were logged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.run.cdr import Table, tables

Array = NDArray[np.float64]
Times = NDArray[np.int64]


EARLY = 100_000_000
"""How long before the first tick of its run a message may have been logged [ns]."""


@dataclass(frozen=True)
class Series:
    """The messages of one topic.

    Attributes:
        log_times: When each was recorded, shape (n,), ns since the epoch.
        stamps: Its header stamp, the tick, shape (n,), ns.
        tables: The messages grouped by layout.
    """

    log_times: Times
    stamps: Times
    tables: list[Table]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.stamps)

    def since(self, log_time: int) -> NDArray[np.bool_]:
        """Return which messages were logged at or after a time, shape (n,)."""
        return np.asarray(self.log_times >= log_time)

    def rows(self, name: str, count: int) -> Array:
        """Return a group of doubles of every message, shape (n, count).

        Messages that hold another number of doubles give NaN.
        """
        out = np.full((len(self), count), np.nan)
        for table in self.tables:
            if table.layout.doubles[name][1] == count:
                out[table.rows] = table.doubles(name)
        return out

    def joints(self, name: str, joints: list[str]) -> Array:
        """Return a field of JointState messages in a given order of joints, shape (n, m).

        Messages without that field or with other joints give NaN.
        """
        out = np.full((len(self), len(joints)), np.nan)
        for table in self.tables:
            given = table.layout.texts[1:]
            if table.layout.doubles[name][1] == len(given) and sorted(given) == sorted(joints):
                order = [given.index(joint) for joint in joints]
                out[table.rows] = table.doubles(name)[:, order]
        return out

    @property
    def joint_names(self) -> list[str]:
        """Names in the first JointState."""
        return next((t.layout.texts[1:] for t in self.tables if 0 in t.rows), [])


@dataclass
class _Messages:
    times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def read_series(bag: Path, types: Mapping[str, str], stop: int | None = None) -> dict[str, Series]:
    """Read topics in one pass.

    Args:
        bag: Bag folder or file.
        types: Type of each wanted topic by full name; absent topics give empty series.
        stop: Log time at which a reset begins the next section, ns; None for the end of the bag.

    Raises:
        BagError: If the bag cannot be read or holds a broken message.
    """
    found = {topic: _Messages() for topic in types}
    for topic, log_time, data in read_raw(bag, types, stop=stop):
        messages = found[topic]
        messages.times.append(log_time)
        messages.data.append(data)
    series = {topic: _series(types[topic], messages) for topic, messages in found.items()}
    if stop is not None:
        for topic, one in series.items():
            series[topic] = _before(one, types[topic], found[topic], stop)
    return series


def _before(series: Series, type_name: str, messages: _Messages, stop: int) -> Series:
    """Leave out what a node said already about the section that begins at a log time [ns]."""
    back = np.flatnonzero(np.diff(series.stamps) < 0)
    if not len(back) or series.log_times[back[-1] + 1] < stop - EARLY:
        return series
    end = int(back[-1]) + 1
    return _series(type_name, _Messages(messages.times[:end], messages.data[:end]))


def _series(type_name: str, messages: _Messages) -> Series:
    stamps = np.zeros(len(messages.data), dtype=np.int64)
    grouped = list(tables(type_name, messages.data))
    for table in grouped:
        stamps[table.rows] = table.stamps
    return Series(np.array(messages.times, dtype=np.int64), stamps, grouped)
