# SPDX-License-Identifier: Apache-2.0
"""What follows from the arrays of a run and its scenario, simulated or recorded alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import LOST_KEY
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.assumptions import Assumption, assumptions
from tactile_hand_ros.run.events import Asked, Event, asked_events, events, releases
from tactile_hand_ros.run.metrics import Metrics, metrics
from tactile_hand_ros.run.recording import BagMetrics
from tactile_hand_ros.scenario.scenario import Scenario, resolved


class RunData:
    """A run in arrays; `Run` fills in what only a bag holds.

    Attributes:
        record: The run tick by tick; NaN where there is no message.
        scenario: What was run; None where that is not known or cannot be used.
        scenario_problem: Why the scenario that is there cannot be used, empty otherwise.
        scenario_text: The scenario as YAML, also where it cannot be used; empty where none is.
        name: What the run is called.
        path: What was opened, the present folder without a bag.
        folder: Where results belong.
        earlier: What came before each reset, oldest first.
        steered: Whether a user steered the run, so that no goal judges it.
        requests: The service calls that changed the controller.
        refusals: The commands of users that were refused.
        bag_metrics: Completeness and timing of the bag, None without one.
        latencies: Wall time from each tick to the command that answers it, shape (n,), s; NaN
            without.
        custom_data: What the recorder noted: versions, lost messages.
        start_time: When the recording started, ns since the epoch; None without one.
        description: The URDF of the hand as recorded, empty where it was not.
    """

    path = folder = Path()
    scenario_problem = description = ""
    earlier: Sequence[RunData] = ()
    steered = False
    requests: Sequence[Asked] = ()
    refusals: Sequence[Asked] = ()
    bag_metrics: BagMetrics | None = None
    custom_data: Mapping[str, str] = {}
    start_time: int | None = None

    def __init__(self, record: Record, scenario: Scenario | None) -> None:
        """Take the arrays of a run and what was run, None where that is not known."""
        self.record, self.scenario = record, scenario
        self.name = "run" if scenario is None else scenario.name
        self.scenario_text = "" if scenario is None else resolved(scenario)
        self.latencies = np.full(len(record), np.nan)

    @property
    def lost_messages(self) -> int | None:
        """How many messages of the hand the recorder lost, None where it does not say.

        What a node publishes on the topics that every node has, before the recorder has found it,
        is lost on a busy machine; the run is complete without it.
        """
        noted = {k.removeprefix(LOST_KEY): n for k, n in self.custom_data.items() if LOST_KEY in k}
        counts = [n for topic, n in noted.items() if topic and topic not in names.OF_ALL]
        return sum(int(n) for n in counts if n.isdigit()) if noted else None

    @cached_property
    def metrics(self) -> Metrics:
        """What was achieved."""
        found = metrics(self.record, self.scenario, releases=releases(self.requests))
        return replace(found, goal_reached=None) if self.steered else found

    @property
    def headline(self) -> str:
        """What became of the run, in a few words; empty where nothing judges it."""
        return self.metrics.headline(steered=self.steered)

    @property
    def assumptions(self) -> list[Assumption]:
        """The assumptions A1 to A7 and when each held; empty where the hand is not known."""
        return self._assumptions[0]

    @property
    def assumptions_problem(self) -> str:
        """Why there are no assumptions although there is a scenario, empty otherwise.

        A bag is read elsewhere too, where the file of its hand is another or none.
        """
        return self._assumptions[1]

    @cached_property
    def _assumptions(self) -> tuple[list[Assumption], str]:
        if self.scenario is None:
            return [], ""
        try:
            hand = Hand.load(self.scenario.hand, self.scenario.layout)
        except TactileHandError as error:
            return [], f"The assumptions are left out, because the hand is not known here: {error}."
        here = hand.fingers, hand.joints
        recorded = len(self.record.finger_names), len(self.record.joint_names)
        if here != recorded:
            return [], (
                f"The assumptions are left out, because the hand '{self.scenario.hand}' has "
                f"{here[0]} fingers and {here[1]} joints here, "
                f"{recorded[0]} and {recorded[1]} in the bag."
            )
        return assumptions(self.record, hand), ""

    @cached_property
    def events(self) -> list[Event]:
        """What happened, in order of time: see `run.events.Event`."""
        found = events(self.record, self.scenario, dropped=self.metrics.dropped_at_s)
        found += asked_events(self.requests, self.refusals)
        return sorted(found, key=lambda event: event.time)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame with one row a tick, indexed by time in s.

        Columns are called ``theta.<joint>``, ``forces.<finger>.y`` and so on; ``attrs["meaning"]``
        says what each array is and its unit.

        Raises:
            MissingLibraryError: If pandas is not installed.
        """
        pandas = optional("pandas", "The export to pandas")
        table = pandas.DataFrame(columns(self.record), index=self.record.times)
        table.index.name = "time_s"
        table.attrs["meaning"] = {
            f.name: f.metadata["meaning"] for f in fields(Record) if f.metadata
        }
        return table


def columns(record: Record) -> dict[str, Any]:
    """Return the arrays of a record column by column, by names such as ``forces.thumb.y``."""
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
