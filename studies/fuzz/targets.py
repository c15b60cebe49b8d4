# SPDX-License-Identifier: Apache-2.0
"""What is fuzzed without a running hand: readers of messages and of files."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from studies.fuzz.mutation import damaged, damaged_text
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.ros.messages import (
    ContactsCodec,
    JointCodec,
    PoseCodec,
    WrenchCodec,
    read_number,
)
from tactile_hand_ros.scenario.scenario import load_scenario

_OF_MESSAGES = 40  # which are read a hundred times as fast as files
_FINGERS = ["finger_1", "finger_2", "finger_3"]


class Target(NamedTuple):
    """Something that reads hostile input.

    Attributes:
        make: Makes an input.
        read: Reads it; raises `TactileHandError` to refuse it, and nothing else.
        weight: How many inputs it gets in a turn.
    """

    make: Callable[[random.Random], bytes]
    read: Callable[[bytes], object]
    weight: int = 1


@contextmanager
def reading_targets() -> Iterator[dict[str, Target]]:
    """Provide the targets by name, with a folder for what they write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield {**_wire(), **_files(folder), **_bags(folder)}


class Reader(NamedTuple):
    """What reads the bytes of a message.

    Attributes:
        decode: Returns stamp, ns, and content; raises `MessageError` to refuse them.
        good: Bytes that it reads.
    """

    decode: Callable[[bytes], tuple[int, Any]]
    good: bytes


def message_readers() -> dict[str, Reader]:
    """Return a reader for each kind of message that the nodes read."""
    three, turns = np.array([0.5, -1.0, 2.0]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    nan = np.full(3, np.nan)
    joints = JointCodec(_FINGERS, ("position", "velocity", "effort"))
    efforts, contacts = JointCodec(_FINGERS, ("effort",)), ContactsCodec(3)
    force, slip, grip = (
        WrenchCodec("tip"),
        JointCodec(_FINGERS, ("position", "velocity")),
        JointCodec(_FINGERS),
    )
    optimal, any_frame = WrenchCodec("tip", nan_allowed=True), WrenchCodec("palm", any_frame=True)
    untouched = contacts.encode(np.eye(3) * np.nan, turns * np.nan, 7)
    return {
        "joints": Reader(joints.decode, joints.encode(7, three, three, three)),
        "efforts": Reader(efforts.decode, efforts.encode(7, three)),
        "contacts": Reader(contacts.decode, contacts.encode(np.eye(3), turns, 7)),
        "no contacts": Reader(contacts.decode, untouched),
        "force": Reader(force.decode, force.encode(three, 7)),
        "no force": Reader(optimal.decode, optimal.encode(nan, 7)),
        "force in any frame": Reader(any_frame.decode, force.encode(three, 7)),
        "slip": Reader(slip.decode, slip.encode(7, three, three)),
        "grip": Reader(grip.decode, grip.encode(7, three, three, three)),
        "pose": Reader(PoseCodec().decode, PoseCodec().encode(three, turns[0], 7)),
        "number": Reader(_read_number, bytes(serialize_message(Float64(data=3.0)))),
    }


def _read_number(data: bytes) -> tuple[int, Any]:
    return 0, read_number(data)


def _wire() -> dict[str, Target]:
    def target(reader: Reader) -> Target:
        return Target(lambda chance: damaged(reader.good, chance), reader.decode, _OF_MESSAGES)

    return {f"wire {name}": target(reader) for name, reader in message_readers().items()}


def _files(folder: Path) -> dict[str, Target]:
    hands = find_file("hand", "paper").parent
    for name in ("paper.yaml", "paper.urdf"):
        shutil.copy(hands / name, folder / name)
    texts = {
        "scenario": find_file("scenario", "pull").read_text(encoding="utf-8"),
        "hand": (hands / "paper.yaml").read_text(encoding="utf-8"),
        "urdf": (hands / "paper.urdf").read_text(encoding="utf-8").replace('"', ' " '),
    }

    def scenario(data: bytes) -> object:
        file = _written(folder / "scenario.yaml", data)
        return load_scenario(str(file)).plant.object.solid()

    def hand(data: bytes) -> object:
        return Hand.load(str(_written(folder / "hand.yaml", data)))

    def urdf(data: bytes) -> object:
        other = folder / "urdf"
        other.mkdir(exist_ok=True)
        shutil.copy(folder / "paper.yaml", other / "paper.yaml")
        _written(other / "paper.urdf", data)
        return Hand.load(str(other / "paper.yaml"))

    reads = {"scenario": scenario, "hand": hand, "urdf": urdf}

    def target(name: str) -> Target:
        return Target(lambda chance: damaged_text(texts[name], chance), reads[name])

    return {name: target(name) for name in reads}


def _written(file: Path, data: bytes) -> Path:
    file.write_bytes(data)
    return file


def write_sample_bag(folder: Path) -> Path:
    """Write a bag of small chunks, and return its folder."""
    with BagWriter(folder, chunk_size=300, custom_data={"scenario": "name: x\n"}) as writer:
        for name in ("Float64", "String"):
            channel = writer.add_channel(f"/{name}", f"std_msgs/msg/{name}")
            for i in range(20):
                writer.write(channel, b"\0\1\0\0\4\0\0\0abc\0" + bytes(4), i, i)
    return folder


def _bags(folder: Path) -> dict[str, Target]:
    good = write_sample_bag(folder / "good" / "bag")
    metadata = (good / "metadata.yaml").read_text(encoding="utf-8")
    mcap = (good / "bag_0.mcap").read_bytes()

    def use(name: str, data: bytes) -> None:
        work = folder / "work"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(good, work / "bag")
        bag = work / "bag"
        (bag / name).write_bytes(data)
        calls: tuple[Callable[[], object], ...] = (
            lambda: summarize(bag),
            lambda: list(read_messages(bag)),
            lambda: recover(bag, work / "out"),
        )
        for call in calls:
            with suppress(TactileHandError):
                call()

    return {
        "metadata": Target(
            lambda chance: damaged_text(metadata, chance), lambda data: use("metadata.yaml", data)
        ),
        "bag": Target(lambda chance: damaged(mcap, chance), lambda data: use("bag_0.mcap", data)),
    }
