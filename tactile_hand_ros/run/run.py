# SPDX-License-Identifier: Apache-2.0
"""A run on disk: arrays and metrics from its bag."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import SCENARIO_KEY
from tactile_hand_ros.bag.reader import TopicMessages, decode, read_topics, summarize
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.config.plain_yaml import parse_yaml, read_yaml
from tactile_hand_ros.errors import BagError, ConfigurationError, TactileHandError
from tactile_hand_ros.report.result import Result
from tactile_hand_ros.run.events import Asked, read_asked
from tactile_hand_ros.run.reading import (
    HandTopics,
    Series,
    align,
    find_fingers,
    find_prefix,
    read_series,
)
from tactile_hand_ros.run.recording import BagMetrics, bag_metrics, latencies
from tactile_hand_ros.scenario.scenario import Scenario

BAG = "bag"
SCENARIO_FILE = "scenario.yaml"
SUMMARY_FILE = "summary.json"


class Run(Result):
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
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Open a run.

        Args:
            path: Folder of a run (with ``bag/`` in it), or a bag folder or file.
            namespace: Namespace of the hand, if the bag holds several.
            fingers: Names of the fingers in order; by default those of the scenario's hand, or all
                that have topics.
            steered: Whether a user steered it and no goal judges it; by default as summary.json
                next to the bag says.
            progress: Called with the fraction of the bag that is read, while it is read.

        Raises:
            BagError: If there is no such run, or its bag is broken or holds no such hand.
        """
        self.path = Path(path)
        self.bag = _find_bag(self.path)
        self.summary = summarize(self.bag)
        self._prefix = find_prefix(self.summary.types, namespace, self.bag)
        self._given_fingers = fingers
        self._steered, self._progress = steered, progress
        self._stop: int | None = None
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
        """The scenario, from the bag or next to it; None without one that can be used."""
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

    @property
    def scenario_text(self) -> str:
        """The scenario as YAML, also where this version cannot use it; empty where none is."""
        text = self.summary.custom_data.get(SCENARIO_KEY, "")
        return text or super().scenario_text

    @property
    def name(self) -> str:
        """What the run is called: its scenario, else the name of its folder or file."""
        path = self.path.resolve()
        folder = path.parent.name if path.name == BAG else path.stem
        return self.scenario.name if self.scenario is not None else folder

    @property
    def folder(self) -> Path:
        """Where results belong: the run's folder, or next to a bare bag."""
        return self.path if self.bag != self.path else self.bag.parent

    @cached_property
    def messages(self) -> dict[str, TopicMessages]:
        """The messages of the hand's topics by full name, read in one pass over the bag.

        Raises:
            BagError: If the bag is damaged.
        """
        asked = [*map(names.accepted_requests, _CONTROLLERS), *_REFUSALS]
        full = map(self.topics.full, (*asked, names.ROBOT_DESCRIPTION))
        return read_topics(self.bag, {*self.topics.types, *full}, self._progress)

    @cached_property
    def series(self) -> dict[str, Series]:
        """The hand's topics as arrays with log times, by full name.

        Raises:
            BagError: If the bag is damaged.
        """
        series = read_series(self.messages, self.topics.types, self._stop)
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
        return [self._until(int(states.log_times[start])) for start in starts]

    def _until(self, stop: int) -> Run:
        """Return this run as it was before a log time [ns]."""
        run = Run(
            self.path, namespace=self._prefix, fingers=self.topics.fingers, steered=self.steered
        )
        run._stop = stop
        run.__dict__["messages"] = self.messages
        return run

    @cached_property
    def requests(self) -> list[Asked]:
        """The service calls that changed the controller."""
        return self._asked(names.accepted_requests(names.CONTROLLER))

    @cached_property
    def refusals(self) -> list[Asked]:
        """The commands of users that were refused."""
        return sorted(each for name in _REFUSALS for each in self._asked(name))

    def _asked(self, topic: str) -> list[Asked]:
        states = self.series[self.topics.full(names.JOINT_STATES)]
        return read_asked(self.messages[self.topics.full(topic)], states, self._stop)

    @cached_property
    def record(self) -> Record:
        """The run tick by tick, as `ClosedLoop` gives it; NaN where there is no message."""
        return align(self.series, self.topics)

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

    @cached_property
    def bag_metrics(self) -> BagMetrics:
        """Completeness and timing."""
        return bag_metrics(self.series, self.topics, self.summary.message_count)

    @cached_property
    def latencies(self) -> NDArray[np.float64]:
        """Wall time from each tick to the command that answers it, shape (n,), s; NaN without."""
        return latencies(self.series, self.topics)

    @property
    def custom_data(self) -> dict[str, str]:
        """What the recorder noted: versions, lost messages."""
        return self.summary.custom_data

    @property
    def start_time(self) -> int | None:
        """When the recording started, ns since the epoch."""
        return self.summary.start_time

    @property
    def description(self) -> str:
        """The URDF of the hand as recorded, empty where it was not."""
        topic = self.topics.full(names.ROBOT_DESCRIPTION)
        found = self.messages[topic].data
        if not found or self.summary.types[topic] != "std_msgs/msg/String":
            return ""
        return str(decode("std_msgs/msg/String", found[0]).data)


_CONTROLLERS = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)
_REFUSALS = tuple(map(names.rejected, (names.CONTROLLER, names.REGULATOR)))


def _find_bag(path: Path) -> Path:
    if not path.exists():
        raise BagError(f"The run {path} does not exist; give the folder of a run or a bag.")
    if (path / BAG).exists():
        return path / BAG
    if (path / SCENARIO_FILE).exists():
        raise BagError(f"The run {path} has no folder {BAG}/; it was never recorded.")
    return path
