# SPDX-License-Identifier: Apache-2.0
"""Slips, alarms, reactions and contacts as they happen, to the tick."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.cockpit.picture import Picture, Track
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.run.events import PAUSE, REACTION, RISE, SLIDING

_PAUSE, _RECENT = round(1e9 * PAUSE), round(1e9 * REACTION)  # ns

Flags = NDArray[np.bool_]


class Watch:
    """Finds events in each batch of a picture, and reports them when all nodes have come that far.

    Attributes:
        response: Milliseconds from the start of the newest slip to ``detection``, ``reaction``,
            ``torque`` and ``stuck``, with ``finger`` and the time ``at``, s; empty before the first
            slip. ``torque`` is the rise of the norm of the joint torques that acted. Without
            ground truth it starts with the alarm.
    """

    def __init__(self) -> None:
        """Start without events."""
        self.response: dict[str, Any] = {}
        self._last: dict[tuple[str, int], tuple[bool, int]] = {}
        self._waiting: list[tuple[int, str, int]] = []
        self._before: dict[str, float] = {}
        self._onset = 0

    def step(self, picture: Picture) -> Iterator[dict[str, Any]]:
        """Yield the newest events, each with ``time``, ``kind``, ``finger`` and ``text``."""
        tracks, k = picture.tracks, len(picture.fingers)
        slip, grip, touch = (tracks[t] for t in (names.TRUE_SLIP, names.GRIP_STATE, names.CONTACTS))
        start, ended = ("slip", slip) if len(slip.stamps) else ("detection", grip)
        self._waiting += [
            *_rising(slip, lambda v: v > SLIDING, "slip", self._last),
            *_rising(grip, lambda v: v[:, k:] == ContactState.SLIP, "detection", self._last),
            *_rising(touch, lambda v: np.isnan(v[:, ::7]), "contact_lost", self._last),
        ]
        self._waiting.sort(key=lambda each: (each[0], each[1] != start))
        while self._waiting and self._waiting[0][0] <= picture.shown:
            stamp, kind, number = self._waiting.pop(0)
            finger = picture.fingers[number]
            self._note(stamp, kind, finger, start)
            yield _event(stamp, kind, finger, f"{finger}: {_TEXTS[kind]}".replace("_", " "))
        if self.response:
            force, joints = tracks[names.GRASP_FORCE], tracks[names.JOINT_STATES]
            torque = joints.values[:, -len(picture.joint_names) :]
            if rise := self._rise("reaction", force.stamps, force.values[:, 1]):
                yield _event(rise, "reaction", "", "the grasp force rises")
            self._rise("torque", joints.stamps, np.linalg.norm(torque, axis=1))
            self._end(ended, start)

    def _note(self, stamp: int, kind: str, finger: str, start: str) -> None:
        r, since = self.response, stamp - self._onset
        if kind == start and (not r or "stuck" in r or since > _RECENT):
            self.response = {"at": 1e-9 * stamp, "finger": finger}
            self._onset, self._before = stamp, {}
        elif kind == "detection" and r and since <= _RECENT:
            r.setdefault("detection", 1e-6 * since)

    def _rise(self, key: str, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> int:
        """Note and return the stamp, ns, of the first rise above the value at the start, or 0."""
        since = stamps - self._onset
        if key not in self._before and (since < 0).any():
            self._before[key] = (1.0 + RISE) * values[since < 0][-1]
        limit = self._before.get(key, np.inf)
        rows = np.flatnonzero((since >= 0) & (since <= _RECENT) & (values > limit))
        if key in self.response or not len(rows):
            return 0
        self.response[key] = 1e-6 * int(since[rows[0]])
        return int(stamps[rows[0]])

    def _end(self, track: Track, start: str) -> None:
        """Note when the last finger stopped, once none has slipped for a while."""
        last = max(at for (kind, _), (_, at) in self._last.items() if kind == start)
        if track.new and track.stamps[-1] - last > _PAUSE:
            self.response.setdefault("stuck", 1e-6 * (last - self._onset))


_TEXTS = {"slip": "slip begins", "detection": "slip detected", "contact_lost": "contact lost"}


def _event(stamp: int, kind: str, finger: str, text: str) -> dict[str, Any]:
    return {"time": 1e-9 * stamp, "kind": kind, "finger": finger, "text": text}


def _rising(
    track: Track,
    judge: Callable[[NDArray[np.float64]], Flags],
    kind: str,
    last: dict[tuple[str, int], tuple[bool, int]],
) -> Iterator[tuple[int, str, int]]:
    """Yield stamp, kind and finger where a flag becomes true after a pause.

    `last` keeps the flag of each finger and when it was last true, ns.
    """
    if not track.new:
        return
    stamps, flags = track.stamps[-track.new :], judge(track.values[-track.new :])
    for finger, column in enumerate(flags.T):
        was, at = last.get((kind, finger), (kind == "contact_lost", -_PAUSE))
        for row in np.flatnonzero(column != np.concatenate([[was], column[:-1]])).tolist():
            if column[row] and stamps[row] - at > _PAUSE:
                yield int(stamps[row]), kind, finger
            at = int(stamps[row - 1]) if not column[row] and row else at
        at = int(stamps[-1]) if column[-1] else at
        last[kind, finger] = bool(column[-1]), at
