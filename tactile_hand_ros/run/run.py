# SPDX-License-Identifier: Apache-2.0
"""A run on disk: arrays, metrics and diagnostics from its bag."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import SCENARIO_KEY
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.config.plain_yaml import parse_yaml, read_yaml
from tactile_hand_ros.errors import BagError, ConfigurationError, TactileHandError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.assumptions import Assumption, assumptions
from tactile_hand_ros.run.events import Asked, Event, asked_events, events, read_asked, releases
from tactile_hand_ros.run.metrics import Metrics, Settling, metrics, recoveries
from tactile_hand_ros.run.reading import (
    HandTopics,
    Series,
    align,
    find_fingers,
    find_prefix,
    read_series,
)
from tactile_hand_ros.run.recording import BagMetrics, bag_metrics, latencies
from tactile_hand_ros.run.verdict import headline
from tactile_hand_ros.scenario.scenario import Scenario

BAG = "bag"
SCENARIO_FILE = "scenario.yaml"
SUMMARY_FILE = "summary.json"


@dataclass(frozen=True)
class Diagnosis:
    """One diagnostic message of one node.

    Attributes:
        log_time: When it was recorded, ns since the epoch.
        name: Name of the node.
        level: 0 OK, 1 WARN, 2 ERROR, 3 STALE.
        message: Its sentence.
        values: Facts by name, as text.
    """

    log_time: int
    name: str
    level: int
    message: str
    values: dict[str, str]


class Run:
    """A recorded run; everything is read when it is first used.

    Attributes:
        path: What was opened.
        bag: The bag in it.
        summary: Topics, message counts and times of the bag.
    """

    def __init__(
        self,
        path: Path | str = "runs/latest",
        *,
        namespace: str | None = None,
        fingers: Sequence[str] | None = None,
        steered: bool | None = None,
        stop: int | None = None,
    ) -> None:
        """Open a run.

        Args:
            path: Folder of a run (with ``bag/`` in it), or a bag folder or file.
            namespace: Namespace of the hand, if the bag holds several.
            fingers: Names of the fingers in order; by default those of the scenario's hand, or all
                that have topics.
            steered: Whether a user steered it and no goal judges it; by default as summary.json
                beside the bag says.
            stop: Log time before which the run ends, ns; see `earlier`.

        Raises:
            BagError: If there is no such run, or its bag is broken or holds no such hand.
        """
        self.path = Path(path)
        self.bag = _find_bag(self.path)
        self.summary = summarize(self.bag)
        self._prefix = find_prefix(self.summary.types, namespace, self.bag)
        self._given_fingers = fingers
        self._steered, self._stop = steered, stop
        self.topics.check(self.summary.types)

    @cached_property
    def topics(self) -> HandTopics:
        """Names of the hand's topics and fingers."""
        fingers = list(self._given_fingers or self._fingers_of_scenario())
        return HandTopics(self._prefix, fingers or find_fingers(self.summary.types, self._prefix))

    def _fingers_of_scenario(self) -> list[str]:
        """Return the fingers of the scenario's hand, none if the bag is of another hand."""
        if self.scenario is None:
            return []
        try:
            named = load_hand_config(self.scenario.hand).finger_names
        except TactileHandError:  # the hand's file stayed on the machine of the run
            return []
        seen = find_fingers(self.summary.types, self._prefix)
        return named if set(seen) <= set(named) else []

    @property
    def scenario(self) -> Scenario | None:
        """The scenario, from the bag or beside it; None without one that can be used."""
        return self._scenario[0]

    @property
    def scenario_problem(self) -> str:
        """Why the scenario that is there cannot be used, empty otherwise.

        A bag outlives the version that wrote it: its arrays must not be lost with its scenario.
        """
        return self._scenario[1]

    @cached_property
    def _scenario(self) -> tuple[Scenario | None, str]:
        try:
            return self._read_scenario(), ""
        except ConfigurationError as error:
            return None, str(error)

    def _read_scenario(self) -> Scenario | None:
        text = self.summary.custom_data.get(SCENARIO_KEY)
        if text:
            source = f"scenario in {self.bag}"
            return validate(Scenario, parse_yaml(text, source), source)
        for folder in (self.path, self.bag.parent):
            if (folder / SCENARIO_FILE).is_file():
                source = str(folder / SCENARIO_FILE)
                return validate(Scenario, read_yaml(source), source)
        return None

    @cached_property
    def series(self) -> dict[str, Series]:
        """The hand's topics as arrays with log times, by full name.

        Raises:
            BagError: If the bag is damaged.
        """
        series = read_series(self.bag, self.topics.types, self._stop)
        if not len(series[self.topics.full(names.JOINT_STATES)]):
            raise BagError(
                f"The bag {self.bag} has no message on {self.topics.full(names.JOINT_STATES)}, so "
                "there is not a single tick; was the hand running?"
            )
        return series

    @cached_property
    def earlier(self) -> list[Run]:
        """The same bag up to each reset in it: what came before the present run, oldest first.

        A reset sets time back, and everything else here is about what came after the last one.
        """
        states = self.series[self.topics.full(names.JOINT_STATES)]
        starts = np.flatnonzero(np.diff(states.stamps) < 0) + 1
        return [
            Run(
                self.path,
                namespace=self._prefix,
                fingers=self.topics.fingers,
                steered=self.steered,
                stop=int(states.log_times[start]),
            )
            for start in starts
        ]

    @cached_property
    def requests(self) -> list[Asked]:
        """The service calls that changed the controller."""
        return self._asked(names.accepted_requests(names.CONTROLLER))

    @cached_property
    def refusals(self) -> list[Asked]:
        """The commands of users that were refused."""
        found = [self._asked(names.rejected(n)) for n in (names.CONTROLLER, names.REGULATOR)]
        return sorted(each for one in found for each in one)

    def _asked(self, topic: str) -> list[Asked]:
        states = self.series[self.topics.full(names.JOINT_STATES)]
        return read_asked(self.bag, self.topics.full(topic), states, self._stop)

    @cached_property
    def record(self) -> Record:
        """The run tick by tick, as `ClosedLoop` gives it; NaN where there is no message."""
        return align(self.series, self.topics)

    @cached_property
    def metrics(self) -> Metrics:
        """What was achieved."""
        found = metrics(self.record, self.scenario, releases=releases(self.requests))
        return replace(found, goal_reached=None) if self.steered else found

    @cached_property
    def steered(self) -> bool:
        """Whether a user steered the run, so that no goal judges it."""
        if self._steered is not None:
            return self._steered
        try:
            content = json.loads((self.bag.parent / SUMMARY_FILE).read_text(encoding="utf-8"))
            return bool(content["interactive"])
        except (OSError, ValueError, KeyError, TypeError):
            return False  # a bag of its own

    @property
    def headline(self) -> str:
        """What became of the run, in a few words; empty where nothing judges it."""
        return headline(self.metrics.to_dict(), steered=self.steered)

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
    def recoveries(self) -> list[Settling]:
        """How long each disturbance kept the object away; empty without a scenario."""
        return recoveries(self.record, self.scenario) if self.scenario is not None else []

    @cached_property
    def bag_metrics(self) -> BagMetrics:
        """Completeness and timing."""
        return bag_metrics(self.series, self.topics, self.summary.message_count)

    @cached_property
    def latencies(self) -> NDArray[np.float64]:
        """Wall time from each tick to the command that answers it, shape (n,), s; NaN without."""
        return latencies(self.series, self.topics)

    @cached_property
    def events(self) -> list[Event]:
        """What happened, in order of time: see `run.events.Event`."""
        found = events(self.record, self.scenario, dropped=self.metrics.dropped_at_s)
        found += asked_events(self.requests, self.refusals)
        return sorted(found, key=lambda event: event.time)

    @cached_property
    def diagnostics(self) -> list[Diagnosis]:
        """All diagnostics of all nodes, in order of log time."""
        return [
            Diagnosis(
                log_time=log_time,
                name=status.name,
                level=int(status.level),
                message=status.message,
                values={pair.key: pair.value for pair in status.values},
            )
            for _, log_time, message in read_messages(self.bag, [names.DIAGNOSTICS])
            for status in message.status
        ]

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


def _find_bag(path: Path) -> Path:
    if not path.exists():
        raise BagError(f"The run {path} does not exist; give the folder of a run or a bag.")
    if (path / BAG).exists():
        return path / BAG
    if (path / SCENARIO_FILE).exists():
        raise BagError(f"The run {path} has no folder {BAG}/; it was never recorded.")
    return path
