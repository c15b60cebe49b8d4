# SPDX-License-Identifier: Apache-2.0
"""Reading of bags: thin functions on top of rosbags, with errors that state the remedy."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from tactile_hand_ros.bag.metadata import FILE_NAME
from tactile_hand_ros.bag.provenance import RECORD_NAME
from tactile_hand_ros.bag.records import MAGIC, MESSAGE, Data, mapped, parse, records, unpacked
from tactile_hand_ros.errors import BagError

_BAGS = (".mcap", ".db3")
_LARGEST = 2**24  # bytes of metadata.yaml that are read


class RecordedMessage(NamedTuple):
    """One decoded message; log time in ns since the epoch."""

    topic: str
    log_time: int
    message: Any


class RawMessage(NamedTuple):
    """One serialized message; log time in ns since the epoch."""

    topic: str
    log_time: int
    data: bytes


@dataclass(frozen=True)
class BagSummary:
    """What a bag holds; times in ns since the epoch, None without messages."""

    counts: dict[str, int]
    types: dict[str, str]
    start_time: int | None
    end_time: int | None
    custom_data: dict[str, str]

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(self.counts.values())


@contextlib.contextmanager
def open_bag(path: Path | str) -> Iterator[AnyReader]:
    """Open a bag folder or a single ``.mcap`` or ``.db3`` file.

    Raises:
        BagError: If it is missing, empty, truncated or otherwise broken.
    """
    path = Path(path)
    _check_present(path)
    with _damage_refused(path):
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
        _check_values(reader)
    try:
        yield reader
    finally:
        reader.close()


def summarize(path: Path | str) -> BagSummary:
    """Return topics, message counts and times of a bag.

    Raises:
        BagError: If the bag cannot be read.
    """
    with open_bag(path) as reader:
        counts: dict[str, int] = {}
        for connection in reader.connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        some = bool(reader.message_count)
        return BagSummary(
            counts=counts,
            types={connection.topic: connection.msgtype for connection in reader.connections},
            start_time=reader.start_time if some else None,
            end_time=reader.end_time - 1 if some else None,  # rosbags reports the time after it
            custom_data=dict(_custom_data(reader, Path(path))),
        )


def read_messages(
    path: Path | str, topics: Collection[str] | None = None
) -> Iterator[RecordedMessage]:
    """Yield decoded messages in order of their log time.

    Args:
        path: Bag folder or file.
        topics: Full names of the wanted topics; all if None. Absent topics give no messages.

    Raises:
        BagError: If the bag cannot be read.
    """
    with open_bag(path) as reader, _damage_refused(path):
        for connection, log_time, data in _messages(reader, topics):
            message = reader.deserialize(data, connection.msgtype)
            yield RecordedMessage(connection.topic, log_time, message)


def read_raw(path: Path | str, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield messages as their recorded bytes; arguments and errors as `read_messages`."""
    with open_bag(path) as reader:
        for connection, log_time, data in _messages(reader, topics):
            yield RawMessage(connection.topic, log_time, bytes(data))


class TopicMessages(NamedTuple):
    """The messages of one topic in order of their log time, ns since the epoch."""

    log_times: list[int]
    data: list[bytes]


def read_topics(
    path: Path | str,
    topics: Collection[str],
    progress: Callable[[float], None] | None = None,
) -> dict[str, TopicMessages]:
    """Read all messages of topics, several times as fast as `read_raw`.

    Args:
        path: Bag folder or file.
        topics: Full names; absent topics have no messages.
        progress: Called now and then with the fraction of a file that is read.

    Raises:
        BagError: If the bag cannot be read.
    """
    found = {topic: TopicMessages([], []) for topic in topics}
    with open_bag(path) as reader, _damage_refused(path):
        files = _mcap_files(Path(path))
        for file in files:
            _take_messages(file, found, progress)
        for connection, log_time, data in () if files else _messages(reader, topics):
            found[connection.topic].log_times.append(log_time)
            found[connection.topic].data.append(bytes(data))
    return {topic: _in_order(messages) for topic, messages in found.items()}


def _mcap_files(path: Path) -> list[Path]:
    """Return the files of a bag, none if they are of another format."""
    if path.is_dir():
        return sorted(path.glob("*.mcap"))
    return [path] if path.suffix == ".mcap" else []


def _take_messages(
    file: Path, found: dict[str, TopicMessages], progress: Callable[[float], None] | None
) -> None:
    """Add the messages of a file to those of their topics."""
    wanted: dict[int, TopicMessages] = {}

    def take(data: Data, at: int = 0) -> None:
        for opcode, start, stop in records(data, at):
            if opcode == Opcode.MESSAGE:
                channel, log_time, _ = MESSAGE.unpack_from(data, start)
                if channel in wanted:
                    wanted[channel].log_times.append(log_time)
                    wanted[channel].data.append(data[start + MESSAGE.size : stop])
            elif opcode == Opcode.CHANNEL:
                known = parse(Channel, data[start:stop])
                if known.topic in found:
                    wanted[known.id] = found[known.topic]
            elif opcode == Opcode.CHUNK:
                take(unpacked(data[start:stop]))
                if progress is not None:
                    progress(stop / len(data))
            elif opcode == Opcode.DATA_END:
                return

    with mapped(file) as data:
        take(data, len(MAGIC))


def _in_order(messages: TopicMessages) -> TopicMessages:
    """Return messages sorted by log time, equal times as they were written."""
    times = messages.log_times
    if all(a <= b for a, b in pairwise(times)):
        return messages
    order = sorted(range(len(times)), key=times.__getitem__)
    return TopicMessages([times[i] for i in order], [messages.data[i] for i in order])


def decode(type_name: str, data: bytes) -> Any:
    """Return a message of a type that ROS 2 Jazzy brings along.

    Raises:
        BagError: If it is not of that type.
    """
    try:
        return get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, type_name)
    except Exception as error:  # damaged data can fail anywhere in the parsers
        raise BagError(
            f"A message is not a valid {type_name}: {error}; record it again."
        ) from error


def _messages(
    reader: AnyReader, topics: Collection[str] | None
) -> Iterator[tuple[Connection, int, bytes]]:
    return iterate(reader, [c for c in reader.connections if topics is None or c.topic in topics])


def iterate(
    reader: AnyReader,
    connections: Sequence[Connection],
    *,
    start: int | None = None,
    stop: int | None = None,
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, log time and data of an open bag's messages in order of log time.

    Args:
        reader: From `open_bag`.
        connections: Which messages; none if empty.
        start: Earliest log time in ns, inclusive.
        stop: Latest log time in ns, exclusive.

    Raises:
        BagError: If the bag is damaged.
    """
    if connections:  # without any, rosbags would yield all
        with _damage_refused(str(reader.paths[0])):
            yield from reader.messages(connections, start=start, stop=stop)


@contextlib.contextmanager
def _damage_refused(path: Path | str) -> Iterator[None]:
    """Turn errors of the parsers into a `BagError`: damaged data can fail anywhere in them."""
    try:
        yield
    except BagError:
        raise
    except PermissionError as error:
        raise BagError(
            f"The bag {path} cannot be read: {error.strerror}; check its mode."
        ) from None
    except Exception as error:
        reason = str(error).rstrip(".") or type(error).__name__
        if Path(path).is_file() and Path(path).suffix not in _BAGS:
            raise BagError(
                f"{path} is not a bag; give the folder of a run, a bag folder, or a file that ends "
                f"in {' or '.join(_BAGS)}."
            ) from error
        raise BagError(
            f"The bag {path} is empty, cut off or damaged ({reason[:200]}); "
            f"run `tactile-hand recover {path}`."
        ) from error


def _check_present(path: Path) -> None:
    if not path.exists():
        raise BagError(f"The bag {path} does not exist; check the path.")
    if not path.is_dir():
        check_regular(path)
        return
    for entry in path.iterdir():
        if not entry.is_dir():
            check_regular(entry)
    metadata = path / FILE_NAME
    if metadata.exists():
        if metadata.stat().st_size > _LARGEST:
            raise BagError(f"{metadata} is larger than {_LARGEST} bytes.")
        return
    if not any(path.glob("*.mcap")):
        raise BagError(
            f"The folder {path} is not a bag: it has neither {FILE_NAME} nor an .mcap file; "
            "check the path."
        )
    raise BagError(
        f"The bag {path} has no {FILE_NAME}: its recording was cut off or still runs; run "
        f"`tactile-hand recover {path}`."
    )


def check_regular(file: Path) -> None:
    """Refuse what would block or never end when it is read.

    Raises:
        BagError: If it is a device, pipe or socket.
    """
    if file.exists() and not file.is_file():
        raise BagError(f"{file} is a folder, device, pipe or socket, expected a file of a bag.")


def _check_values(reader: AnyReader) -> None:
    """Check what others compute with: rosbags takes it from metadata.yaml as it is.

    Raises:
        ValueError: If something is not what it should be.
    """
    counts = [connection.msgcount for connection in reader.connections]
    numbers = [reader.message_count, reader.start_time, reader.end_time, *counts]
    if any(type(number) is not int or not 0 <= number <= 2**64 for number in numbers):
        raise ValueError(f"{FILE_NAME} has a number that is not an integer of 64 bits")
    texts = [text for each in reader.connections for text in (each.topic, each.msgtype)]
    for part in reader.readers:
        custom = part.storage.metadata.custom if isinstance(part, Reader) else None
        texts += [text for item in dict(custom or {}).items() for text in item]
    if not all(isinstance(text, str) for text in texts):
        raise ValueError(f"{FILE_NAME} has a name, type or custom text that is not a text")


def _custom_data(reader: AnyReader, path: Path) -> dict[str, str]:
    """Return the texts on the origin of a bag; a single file has no metadata.yaml next to it."""
    parts = [part.storage for part in reader.readers if isinstance(part, Reader)]
    found = next((part.metadata.custom for part in parts if part.metadata.custom), {})
    if found or path.is_dir() or path.suffix != ".mcap":
        return found
    with _damage_refused(path), path.open("rb") as file:
        inside = make_reader(file).iter_metadata()
        return next((dict(each.metadata) for each in inside if each.name == RECORD_NAME), {})
