# SPDX-License-Identifier: Apache-2.0
"""Results derived from the arrays of a run and its scenario, simulated or recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import LOST_KEY
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import ObjectModelError, TactileHandError
from tactile_hand_ros.extras import MissingLibraryError, optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.assumptions import Assumption, assumptions
from tactile_hand_ros.run.derived import link_inside
from tactile_hand_ros.run.events import Asked, Event, asked_events, events, releases
from tactile_hand_ros.run.metrics import Metrics, metrics
from tactile_hand_ros.run.recording import BagMetrics
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.scenario.scenario import Scenario, resolved


class RunData:
    """A run as arrays; `Run` adds what only a bag contains.

    Attributes:
        record: The run tick by tick; NaN without a message.
        scenario: The scenario; None if unknown or unusable.
        scenario_problem: Why the recorded scenario is unusable, empty otherwise.
        scenario_text: The scenario as YAML, even if unusable.
        folder: Folder for results.
        earlier: The runs before each reset, oldest first.
        steered: Whether a user steered the run, so that no goal applies.
        requests: The service calls that changed the controller.
        refusals: The user commands that were rejected.
        pushes: When users pushed at the object.
        bag_metrics: Completeness and timing of the bag.
        latencies: Wall time from each tick to its command, shape (n,), s; NaN without a bag.
        custom_data: Notes of the recorder: versions, lost messages.
        start_time: When the recording started, ns since the epoch.
        description: The recorded URDF of the hand.
    """

    path = folder = Path()
    scenario_problem = description = ""
    earlier: Sequence[RunData] = ()
    steered = False
    requests: Sequence[Asked] = ()
    refusals: Sequence[Asked] = ()
    pushes: Sequence[Event] = ()
    bag_metrics: BagMetrics | None = None
    custom_data: Mapping[str, str] = {}
    start_time: int | None = None

    def __init__(self, record: Record, scenario: Scenario | None) -> None:
        """Take the arrays of a run and its scenario, None if unknown."""
        self.record, self.scenario = record, scenario
        self.name = "run" if scenario is None else scenario.name
        self.scenario_text = "" if scenario is None else resolved(scenario)
        self.latencies = np.full(len(record), np.nan)

    @property
    def lost_messages(self) -> int | None:
        """How many messages of the hand the recorder lost, None if it did not report it.

        Topics that every node has do not count: on a busy machine, their first messages may precede
        the recorder's discovery of them, and the run is complete without them.
        """
        noted = {k.removeprefix(LOST_KEY): n for k, n in self.custom_data.items() if LOST_KEY in k}
        counts = [n for topic, n in noted.items() if topic and topic not in names.OF_ALL]
        return sum(int(n) for n in counts if n.isdigit()) if noted else None

    @cached_property
    def metrics(self) -> Metrics:
        """The results as numbers."""
        found = metrics(self.record, self.scenario, releases=releases(self.requests))
        if self.steered:
            found = replace(found, goal_reached=None)
        # Its mesh stayed on the machine of the run, or nothing here reads meshes.
        with suppress(ObjectModelError, MissingLibraryError):
            if self.scenario is not None and self._hand[0] is not None:
                links = LinkCollisions(self._hand[0], self.scenario.plant.object.solid())
                link, since = link_inside(self.record, links)
                found = replace(found, link_inside=link, link_inside_s=since)
        return found

    @property
    def headline(self) -> str:
        """The outcome of the run in a few words; empty if no goal applies."""
        return self.metrics.headline(steered=self.steered)

    @cached_property
    def assumptions(self) -> list[Assumption]:
        """The assumptions A1 to A7 and when each held; empty if the hand is unknown."""
        hand, _ = self._hand
        return [] if hand is None else assumptions(self.record, hand)

    @property
    def assumptions_problem(self) -> str:
        """Why a run with a scenario has no assumptions, empty otherwise."""
        return self._hand[1]

    @cached_property
    def _hand(self) -> tuple[Hand | None, str]:
        """The hand of the scenario, or why a scenario has none that fits the record."""
        if self.scenario is None:
            return None, ""
        try:
            hand = Hand.load(self.scenario.hand, self.scenario.layout)
        except TactileHandError as error:
            return None, f"The assumptions are omitted because the hand cannot be loaded: {error}."
        recorded = len(self.record.finger_names), len(self.record.joint_names)
        if (hand.fingers, hand.joints) != recorded:
            return None, (
                f"The assumptions are omitted because the hand '{self.scenario.hand}' has other "
                "numbers of fingers and joints here than in the bag."
            )
        return hand, ""

    @cached_property
    def events(self) -> list[Event]:
        """The events in order of time: see `run.events.Event`."""
        found = events(self.record, self.scenario, dropped=self.metrics.dropped_at_s)
        found += [*asked_events(self.requests, self.refusals), *self.pushes]
        if link := self.metrics.link_inside:
            text = f"{link} comes inside the object"
            found.append(Event(self.metrics.link_inside_s, "contact_made", link, text))
        return sorted(found, key=lambda event: event.time)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame with one row per tick, indexed by time in s.

        Columns have names such as ``theta.<joint>`` and ``forces.<finger>.y``. ``attrs["meaning"]``
        gives the meaning and unit of each array. Raise MissingLibraryError without pandas.
        """
        pandas = optional("pandas", "The export to pandas")
        table = pandas.DataFrame(columns(self.record), index=self.record.times)
        table.index.name = "time_s"
        arrays = (f for f in fields(Record) if f.metadata)
        table.attrs["meaning"] = {f.name: f.metadata["meaning"] for f in arrays}
        return table


def columns(record: Record) -> dict[str, Any]:
    """Return the arrays of a record as columns with names such as ``forces.thumb.y``."""
    axes = {"k": record.finger_names, "m": record.joint_names, "3": "xyz", "4": "xyzw"}
    out: dict[str, Any] = {}
    for f in fields(Record):
        if not f.metadata:
            continue
        array, shape = getattr(record, f.name), f.metadata["shape"]
        for index in np.ndindex(array.shape[1:]):
            parts = [axes[kind][i] for kind, i in zip(shape, index, strict=True)]
            out[".".join([f.name, *parts])] = array[(slice(None), *index)]
    return out
