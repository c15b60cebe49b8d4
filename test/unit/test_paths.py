# SPDX-License-Identifier: Apache-2.0
"""A tick takes a short path: few modules between its messages and the answer."""

import inspect
import re
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from support.messages import encoded
from support.nodes import facts

import tactile_hand_ros
from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.scenario.scenario import load_scenario

PACKAGE = Path(tactile_hand_ros.__file__).parent
ANSWERS = (names.JOINT_COMMAND, names.GRASP_FORCE)
STEADY = 7
"""Ticks after which no code path is new."""


def bring(node: Any, topic: str, data: bytes, number: int) -> None:
    """Pass a message to a node like its executor."""
    (subscription,) = (each for each in node.subscriptions if each.topic_name == topic)
    info = {"publication_sequence_number": number}
    wants_info = len(inspect.signature(subscription.callback).parameters) > 1
    subscription.callback(data, *([info] if wants_info else []))


def modules_of_a_tick(node: Any) -> list[str]:
    """Return the modules of this package that execute code during a tick of an unserved node.

    Sorted, from the callbacks of the subscriptions to the bytes of the answer. Compiled functions
    do not count, but their callers do.
    """
    found: set[str] = set()
    answers: list[set[str]] = []
    for publisher in node.tick_publishers:
        if publisher.topic.lstrip("/") in ANSWERS:
            publisher.taps.append(lambda _: answers.append(set(found)))

    def note(frame: FrameType, event: str, _: Any) -> None:
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(PACKAGE):
            found.add(str(file.relative_to(PACKAGE).with_suffix("")))

    sent = encoded(ClosedLoop(load_scenario("paper")).run(STEADY + 1))
    subscribed = {each.topic_name for each in node.subscriptions}
    topics = [topic for topic in sent if topic in subscribed]
    topics.sort(key=lambda topic: topic == f"/{names.JOINT_STATES}")  # the joints come last
    for tick in range(STEADY + 1):
        found.clear()
        sys.setprofile(note)
        try:
            for topic in topics:
                bring(node, topic, sent[topic][tick], tick + 1)
        finally:
            sys.setprofile(None)
    assert len(answers) == int(facts(node)["ticks"]) == STEADY + 1
    return sorted(answers[-1])


def drawn(heading: str) -> set[str]:
    """Return the modules in the diagram of docs/explanation/architecture.md below a line."""
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "explanation" / "architecture.md").read_text("utf-8")
    diagram = page.split(heading, 1)[1].split("```")[1]
    words = set(re.findall(r"[a-z_]+(?:/[a-z_]+)*", diagram))
    return {word for word in words if (PACKAGE / f"{word}.py").is_file()}


@pytest.mark.parametrize(
    ("kind", "maximum", "heading"),
    [(ManipulationControllerNode, 14, "A tick, from"), (SlipRegulatorNode, 12, "A slip, from")],
)
def test_a_tick_passes_through_few_modules_and_all_are_drawn(here, kind, maximum, heading):
    node = kind(context=here.context)
    found = modules_of_a_tick(node)
    node.destroy_node()
    assert len(found) <= maximum, f"{len(found)}: {', '.join(found)}"
    assert set(found) <= drawn(heading)
