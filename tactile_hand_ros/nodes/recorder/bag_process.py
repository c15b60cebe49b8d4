# SPDX-License-Identifier: Apache-2.0
"""The process that writes a bag for a recorder which shares its process with a hand.

Python runs one thread at a time, so a thread that packs and compresses messages would hold up the
tick. This process gets them through a pipe, looks into it every few milliseconds, and ignores
signals: it ends when the pipe does. What is in the pipe is written even if the sender was killed.

It reads stdin and answers on the file descriptor that its argument names; see `WriterProcess`.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import struct
import sys
from collections.abc import Iterator
from typing import Any

from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

FRAME = struct.Struct("<IIqq")
"""Begins each message: channel, number of bytes, times of reception and publication [ns]. Channel
0 is a call instead: the pickled name and arguments of a method of `BagWriter`."""

_LOOK = 0.005  # s between two looks into the pipe
_PIECE = 1 << 20


def main() -> int:
    """Write until the pipe ends; return 0 if the bag was closed."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _let_the_hand_go_first()
    replies = int(sys.argv[1])
    try:
        return 0 if _serve(sys.stdin.fileno(), replies) else 1
    except BagError as error:
        _reply(replies, error)
        return 1


def _let_the_hand_go_first() -> None:
    """Take back what the hand's process has been given: this one may be late."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))


def _serve(pipe: int, replies: int) -> bool:
    """Write what comes; return whether the bag was closed before the pipe ended."""
    frames = _frames(pipe)
    first = next(frames, None)
    if first is None:
        return False
    writer = BagWriter(**pickle.loads(first[1]))
    _reply(replies, None)
    for (channel, _, received, sent), data in frames:
        if channel:
            writer.write(channel, data, received, sent)
            continue
        name, arguments, is_answered = pickle.loads(data)
        writer.custom_data.update(arguments.pop("custom_data", {}))
        result = getattr(writer, name)(**arguments)
        if is_answered:
            _reply(replies, result)
    if writer.is_open:
        writer.flush()
        return False
    return True


def _frames(pipe: int) -> Iterator[tuple[tuple[int, int, int, int], bytes]]:
    """Yield the header and the bytes of each whole frame until the pipe ends."""
    rest = b""
    while True:
        piece = os.read(pipe, _PIECE)
        if not piece:
            return
        rest += piece
        at, end = 0, len(rest)
        while at + FRAME.size <= end:
            header = FRAME.unpack_from(rest, at)
            after = at + FRAME.size + header[1]
            if after > end:
                break
            yield header, rest[at + FRAME.size : after]
            at = after
        rest = rest[at:]
        if len(piece) < _PIECE:
            # Asleep, and not in `read`: then a sender need not wake this process each time.
            select.select([], [], [], _LOOK)


def _reply(replies: int, result: Any) -> None:
    with contextlib.suppress(BrokenPipeError):
        os.write(replies, pickle.dumps(result))
