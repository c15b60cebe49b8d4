# SPDX-License-Identifier: Apache-2.0
"""A `BagWriter` that does its work in another process."""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tactile_hand_ros.bag.metadata import BagMetadata
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import bag_process
from tactile_hand_ros.nodes.recorder.bag_process import FRAME

# What lies in the working directory must not be taken for a library.
_PROGRAM = f"""
import sys
sys.path = [path for path in sys.path if path]
from {bag_process.__name__} import main
sys.exit(main())
"""
_PIPE_SIZE = 1 << 20  # bytes, what the kernel gives to any user
_MOST_WAITING = 64 << 20
"""Bytes that wait here while the pipe is full; what comes then is lost, and counted."""

_PATIENCE = 30.0  # s, longest wait for an answer


class WriterProcess:
    """Writes serialized messages to a new bag, as `BagWriter` does, without waiting for it.

    Attributes:
        folder: Folder of the bag.
        custom_data: Texts for the bag's metadata; may be filled until `close`.
        message_count: Number of messages accepted so far.
        bytes_received: Number of their bytes.
        lost: Messages that were not accepted, by channel.
        is_open: Whether messages are accepted.
    """

    def __init__(self) -> None:
        """Start the process; `begin` says what to write."""
        answers, replies = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(replies)],
            stdin=subprocess.PIPE,
            pass_fds=(replies,),
            start_new_session=True,  # a Ctrl-C is not for it
        )
        os.close(replies)
        assert self._process.stdin is not None
        self._pipe, self._answers = self._process.stdin.fileno(), answers
        fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
        os.set_blocking(self._pipe, False)
        self._frames: list[bytes] = []
        self._waiting: deque[memoryview] = deque()
        self._waiting_bytes = 0
        self._channels = 0
        self.custom_data: dict[str, str] = {}
        self.message_count = self.bytes_received = 0
        self.lost: Counter[int] = Counter()
        self.is_open = True

    @property
    def process_id(self) -> int:
        """Number of the process."""
        return self._process.pid

    def begin(self, folder: Path, **options: Any) -> None:
        """Create the bag with the options of `BagWriter`; `check` says whether that worked."""
        self.folder = folder
        self.custom_data = dict(options.get("custom_data", {}))
        self._append(pickle.dumps({"folder": folder, **options}))
        self.send()

    def check(self) -> None:
        """Wait for the bag.

        Raises:
            BagError: If it cannot be created.
        """
        self._answer()

    def add_channel(self, topic: str, type_name: str, **options: Any) -> int:
        """Announce a topic and return its number; see `BagWriter.add_channel`."""
        self._call("add_channel", topic=topic, type_name=type_name, **options)
        self._channels += 1
        return self._channels

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._call("add_metadata", name=name, values=dict(values))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int) -> None:
        """Append one serialized message, which is on its way after the next `send`; times in ns."""
        if self._waiting_bytes > _MOST_WAITING:
            self.lost[channel] += 1
            return
        self._frames += (FRAME.pack(channel, len(data), log_time, publish_time), data)
        self.message_count += 1
        self.bytes_received += len(data)

    def send(self) -> None:
        """Put into the pipe what fits, without waiting.

        Raises:
            BagError: If the process has ended.
        """
        if self._frames:
            piece = b"".join(self._frames)
            self._frames.clear()
            self._waiting.append(memoryview(piece))
            self._waiting_bytes += len(piece)
        while self._waiting:
            try:
                written = os.write(self._pipe, self._waiting[0])
            except BlockingIOError:
                return
            except OSError:
                raise self._failure() from None
            self._waiting_bytes -= written
            if written == len(self._waiting[0]):
                self._waiting.popleft()
            else:
                self._waiting[0] = self._waiting[0][written:]

    def flush(self) -> None:
        """Let the process finish its chunk, so that the messages survive its death, too."""
        self._call("flush")
        self.send()

    def checkpoint(self) -> None:
        """Finish the present file and wait until the folder is a whole bag.

        Raises:
            BagError: If the disk refuses the data.
        """
        self._call("checkpoint", is_answered=True)
        self._answer()

    def close(self) -> BagMetadata:
        """Write index and metadata, and wait for them.

        Raises:
            BagError: If the disk refuses the data.
        """
        self._call("close", custom_data=self.custom_data, is_answered=True)
        self.is_open = False
        metadata = self._answer()
        self._end()
        assert isinstance(metadata, BagMetadata)
        return metadata

    def _call(self, method: str, *, is_answered: bool = False, **arguments: Any) -> None:
        self._append(pickle.dumps((method, arguments, is_answered)))

    def _append(self, data: bytes) -> None:
        self._frames += (FRAME.pack(0, len(data), 0, 0), data)

    def _answer(self) -> Any:
        """Send everything and return the next answer.

        Raises:
            BagError: If the answer is one, or there is none.
        """
        self.send()
        while self._waiting and select.select([], [self._pipe], [], _PATIENCE)[1]:
            self.send()
        if not select.select([self._answers], [], [], _PATIENCE)[0]:
            raise BagError(
                f"The process that writes {self.folder} has not answered for {_PATIENCE:g} s;"
                f" `tactile-hand recover {self.folder}` saves what it has written."
            )
        return self._received()

    def _received(self) -> Any:
        parts = []
        while part := os.read(self._answers, _PIPE_SIZE):
            parts.append(part)
            try:
                result = pickle.loads(b"".join(parts))
            except (EOFError, pickle.UnpicklingError):
                continue
            if isinstance(result, BagError):
                raise result
            return result
        raise BagError(
            f"The process that writes {self.folder} has ended; run "
            f"`tactile-hand recover {self.folder}`."
        )

    def _failure(self) -> BagError:
        """Return why the process has ended."""
        self.is_open = False
        try:
            self._received()
        except BagError as error:
            return error
        return BagError(f"The bag {self.folder} was not written to its end.")

    def _end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(_PATIENCE)
        os.close(self._answers)
