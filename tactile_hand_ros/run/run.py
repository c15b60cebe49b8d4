# SPDX-License-Identifier: Apache-2.0
"""A run on disk: arrays and metrics from its bag."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import SCENARIO_KEY
from tactile_hand_ros.bag.reader import TopicMessages, decode, find_bag, read_topics, summarize
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.errors import BagError, ConfigurationError, TactileHandError
from tactile_hand_ros.report.page import Result
from tactile_hand_ros.run.events import Asked, read_asked, read_pushes
from tactile_hand_ros.run.reading import (
    HandTopics,
    align,
    find_fingers,
    find_prefix,
    read_series,
    sections,
)
from tactile_hand_ros.run.recording import BagMetrics, bag_metrics, latencies
from tactile_hand_ros.scenario.files import read_layers
from tactile_hand_ros.scenario.scenario import Scenario, resolved

BAG = "bag"
SCENARIO_FILE = "scenario.yaml"
SUMMARY_FILE = "summary.json"

_CONTROLLERS = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)
_REFUSALS = tuple(map(names.rejected, (names.CONTROLLER, names.REGULATOR)))


class Run(Result):
    """A recorded run.

    A reset sets time back. All attributes describe the part after the last reset; `earlier` holds
    the parts before it.

    Attributes:
        path: The opened path.
        bag: Its bag.
        summary: Topics, message counts and times of the bag.
        topics: Names of the hand's topics and fingers.
        messages: The messages of the hand's topics by full name.
        series: The same as arrays with log times.

    Example:
        >>> run = Run("runs/latest")
        >>> run.record.theta.shape, run.record.finger_names
        ((51, 9), ['finger_1', 'finger_2', 'finger_3'])
    """

    bag_metrics: BagMetrics

    def __init__(
        self,
        path: Path | str = "runs/latest",
        *,
        namespace: str | None = None,
        fingers: Sequence[str] | None = None,
        steered: bool | None = None,
    ) -> None:
        """Read a run completely.

        Args:
            path: Folder of a run (with ``bag/`` in it), or a bag folder or file.
            namespace: Namespace of the hand, if the bag holds several.
            fingers: Names of the fingers in order; by default those of `grip_state`, or of the
                scenario's hand, or all that have topics.
            steered: Whether a user steered it, so that no goal applies; by default as recorded in
                the summary.json next to the bag.

        Raises:
            BagError: If there is no such run, or its bag is broken or holds no such hand.
            MessageError: If a message in it is broken.
        """
        self.path = Path(path)
        self.bag = find_bag(self.path)
        self.summary = summarize(self.bag)
        self.custom_data, self.start_time = self.summary.custom_data, self.summary.start_time
        # Results belong in the run's folder, or next to a bare bag.
        is_inside = self.bag.is_file() and self.bag.parent.name == BAG
        self.folder = self.bag.parent.parent if is_inside else self.bag.parent
        self._load_scenario()
        self.steered = self._was_steered() if steered is None else steered
        whole = self.path.resolve()
        folder = whole.parent.name if whole.name == BAG else whole.stem
        self.name = folder if self.scenario is None else self.scenario.name
        self.topics = self._find_topics(namespace, fingers)
        asked = [*map(names.accepted_requests, _CONTROLLERS), *_REFUSALS]
        wanted = {*self.topics.types, *map(self.topics.full, [*asked, names.PUSH])}
        description = self.topics.full(names.ROBOT_DESCRIPTION)
        messages = read_topics(self.bag, {*wanted, description})
        if fingers is None:
            self.topics = self.topics.ordered(messages[self.topics.full(names.GRIP_STATE)].data)
        if texts := messages.pop(description).data:
            self.description = str(decode("std_msgs/msg/String", texts[0]).data)
        states = self.topics.full(names.JOINT_STATES)
        if not messages[states].data:
            raise BagError(
                f"The bag {self.bag} has no message on {states}, so it contains no ticks; "
                "was the hand running?"
            )
        *earlier, last = sections(messages, states)
        self.earlier = [copy.copy(self)._take(section) for section in earlier]
        self._take(last)

    def _load_scenario(self) -> None:
        """Load the scenario from the bag or from the file next to it.

        A bag outlives the version that wrote it, so an outdated scenario must not fail the run.
        """
        text = self.custom_data.get(SCENARIO_KEY, "")
        files = (folder / SCENARIO_FILE for folder in (self.path, self.folder))
        file = next((file for file in files if file.is_file()), None)
        self.scenario, self.scenario_text = None, text
        try:
            if text:
                source = f"scenario in {self.bag}"
                self.scenario = validate(Scenario, parse_yaml(text, source), source)
            elif file is not None:
                self.scenario = validate(Scenario, read_layers(file), str(file))
                self.scenario_text = resolved(self.scenario)
        except ConfigurationError as error:
            self.scenario_problem = str(error)

    def _was_steered(self) -> bool:
        try:
            content = json.loads((self.folder / SUMMARY_FILE).read_text(encoding="utf-8"))
            return bool(content["interactive"])
        except (OSError, ValueError, KeyError, TypeError):
            return False  # a bare bag

    def _find_topics(self, namespace: str | None, fingers: Sequence[str] | None) -> HandTopics:
        types = self.summary.types
        prefix = find_prefix(types, namespace, self.bag)
        seen = find_fingers(types, prefix)
        unknown = [name for name in fingers or () if name not in seen]
        if seen and unknown:
            raise BagError(
                f"The bag {self.bag} has no finger '{unknown[0]}', but: {', '.join(seen)}."
            )
        of_hand: list[str] = []
        with suppress(TactileHandError):  # the hand's file stayed on the machine of the run
            of_hand = load_hand_config(self.scenario.hand).finger_names if self.scenario else []
        named = list(fingers or (of_hand if set(seen) <= set(of_hand) else seen))
        topics = HandTopics(prefix, named)
        wrong = [topic for topic, kind in topics.types.items() if types.get(topic, kind) != kind]
        if wrong:
            listed = ", ".join(f"{topic} ({types[topic]})" for topic in wrong)
            raise BagError(f"Topics of the bag {self.bag} have wrong types: {listed}.")
        return topics

    def _take(self, messages: Mapping[str, TopicMessages]) -> Run:
        """Fill in everything that follows from the messages of one section."""
        self.messages = messages
        self.series = read_series(messages, self.topics.types)
        self.record = align(self.series, self.topics)
        self.requests = self._asked(names.accepted_requests(names.CONTROLLER))
        self.refusals = sorted(each for name in _REFUSALS for each in self._asked(name))
        self.pushes = read_pushes(messages[self.topics.full(names.PUSH)])
        self.bag_metrics = bag_metrics(self.series, self.topics, self.summary.message_count)
        self.latencies = latencies(self.series, self.topics)
        return self

    def _asked(self, topic: str) -> list[Asked]:
        return read_asked(self.messages[self.topics.full(topic)])
