# SPDX-License-Identifier: Apache-2.0
"""A `BagWriter` in its own process, so that compression and disk do not delay a tick.

Python runs one thread at a time, so a writer thread would delay the ticks of a hand in the same
process. The writing process receives pickled orders through a pipe. It ignores signals and exits
when the pipe closes; it writes the pipe's content even if the sender was killed.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tactile_hand_ros.bag.metadata import OfferedQos
from tactile_hand_ros.errors import BagError

# Before any import, drop the real-time priority of the hand's process: writing may be late. Remove
# the working directory from the path, so that no file there is imported as a library.
_PROGRAM = f"""
import os, sys
try:
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
except OSError:
    pass
sys.path = [path for path in sys.path if path]
from {__name__} import main
sys.exit(main())
"""
_OPEN = b"open\n"
"""Reply of the process once the bag is created; any other reply is an error text."""
_PIPE_SIZE = 1 << 20  # bytes, the kernel's limit for normal users
_MAX_WAITING = 64 << 20  # bytes queued while the pipe is full; more are lost

Message = tuple[int, bytes, int, int]
"""Channel, CDR, times of reception and publication [ns]."""


class WriterProcess:
    """Writes serialized messages to a new bag, as `BagWriter` does, without waiting for it.

    Attributes:
        process: The writing process.
        folder: Folder of the bag.
        custom_data: Texts for the bag's metadata; may be changed until `close`.
        message_count: Number of messages accepted so far.
        bytes_received: Their total size in bytes.
        lost: Number of messages not accepted, by channel.
        is_open: Whether messages are accepted.
    """

    def __init__(self, folder: Path, **options: Any) -> None:
        """Start the process, with options for `BagWriter`, and wait for the bag.

        Raises:
            BagError: If it cannot be created.
        """
        self.process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C must not stop it
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self._replies = self.process.stdout
        self._pipe = self.process.stdin.fileno()
        with contextlib.suppress(OSError):  # a smaller pipe only makes more messages wait here
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
        self._messages: list[Message] = []
        self._waiting = bytearray()
        self._channels = 0
        self.folder = folder
        self.custom_data: dict[str, str] = dict(options.get("custom_data", {}))
        self.message_count = self.bytes_received = 0
        self.lost: Counter[int] = Counter()
        self.is_open = True
        self._order("start", folder=folder, **options)
        self.send()
        reply = self._replies.readline()
        if reply != _OPEN:
            raise self._error(reply)
        os.set_blocking(self._pipe, False)

    def add_channel(
        self, topic: str, type_name: str, offers: Sequence[OfferedQos] = (), type_hash: str = ""
    ) -> int:
        """Announce a topic and return its number; see `BagWriter.add_channel`."""
        self._order(
            "add_channel", topic=topic, type_name=type_name, offers=offers, type_hash=type_hash
        )
        self._channels += 1
        return self._channels

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int) -> None:
        """Queue one serialized message for the next `send`; times in ns."""
        if len(self._waiting) > _MAX_WAITING or not self.is_open:
            self.lost[channel] += 1
            return
        self._messages.append((channel, data, log_time, publish_time))
        self.message_count += 1
        self.bytes_received += len(data)

    def flush(self) -> None:
        """Make the process finish its chunk, so that its messages survive a crash of it."""
        self._order("flush")

    def send(self) -> None:
        """Write to the pipe without blocking.

        Raises:
            BagError: If the process has ended.
        """
        self._pack_messages()
        try:
            while self._waiting:
                del self._waiting[: os.write(self._pipe, self._waiting)]
        except BlockingIOError:
            return
        except OSError:
            raise self._error() from None

    def close(self) -> None:
        """Write index and metadata, and wait for them.

        Raises:
            BagError: If the disk rejects the data.
        """
        self._order("close", custom_data=self.custom_data)
        self.is_open = False
        os.set_blocking(self._pipe, True)
        self.send()
        if self.process.wait():
            raise self._error()
        assert self.process.stdin is not None
        self.process.stdin.close()
        self._replies.close()

    def _order(self, order: str, /, **arguments: Any) -> None:
        self._pack_messages()
        self._waiting += pickle.dumps((order, arguments))

    def _pack_messages(self) -> None:
        if self._messages:
            self._waiting += pickle.dumps(("write", self._messages))
            self._messages.clear()

    def _error(self, reply: bytes = b"") -> BagError:
        self.is_open = False
        text = (reply + self._replies.read()).removeprefix(_OPEN).decode()
        return BagError(
            text
            or f"The process that writes {self.folder} has ended; run "
            f"`tactile-hand recover {self.folder}`."
        )


def main() -> int:
    """Write until the pipe ends; return 0 if the bag was closed."""
    from tactile_hand_ros.bag.writer import BagWriter

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    orders = _orders()
    try:
        for _, options in orders:
            writer = BagWriter(**options)
            os.write(sys.stdout.fileno(), _OPEN)
            return _execute(writer, orders)
    except BagError as error:
        print(error, end="", flush=True)
    return 1


def _orders() -> Iterator[tuple[str, Any]]:
    """Yield orders until the sender closes the pipe."""
    with contextlib.suppress(EOFError, pickle.UnpicklingError):
        while True:
            yield pickle.load(sys.stdin.buffer)


def _execute(writer: Any, orders: Iterator[tuple[str, Any]]) -> int:
    for name, arguments in orders:
        if name == "write":
            for message in arguments:
                writer.write(*message)
        elif name == "close":
            writer.custom_data.update(arguments["custom_data"])
            writer.close()
            return 0
        else:
            getattr(writer, name)(**arguments)
    writer.flush()  # the sender was killed
    return 1
