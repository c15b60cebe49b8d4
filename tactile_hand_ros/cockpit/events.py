# SPDX-License-Identifier: Apache-2.0
"""Slips, alarms, reactions and contacts as they happen, to the tick."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.cockpit.picture import Picture, Track
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.run.events import PAUSE, REACTION, RISE, SLIDING, starts

_PAUSE, _RECENT = round(1e9 * PAUSE), round(1e9 * REACTION)  # ns
_TEXTS = {"slip": "slip begins", "detection": "slip detected", "contact_lost": "contact lost"}


class Watch:
    """Finds events in the newest ticks of a picture, once all nodes have come that far.

    Attributes:
        response: Milliseconds from the start of the newest slip to ``detection``, ``reaction``,
            ``torque`` and ``stuck``, with ``finger`` and the time ``at``, s; empty before the first
            slip. ``torque`` is the rise of the norm of the joint torques that acted. Without
            ground truth it starts with the alarm.
    """

    def __init__(self) -> None:
        """Start without events."""
        self.response: dict[str, Any] = {}
        self._seen = self._onset = 0  # ns

    def step(self, picture: Picture) -> Iterator[tuple[int, str, str, str]]:
        """Yield stamp, ns, kind, finger and text of the newest events."""
        tracks, k = picture.tracks, len(picture.fingers)
        slip, grip, touch = (tracks[t] for t in (names.TRUE_SLIP, names.GRIP_STATE, names.CONTACTS))
        flags = {
            "slip": (slip, slip.values > SLIDING),
            "detection": (grip, grip.values[:, k:] == ContactState.SLIP),
            "contact_lost": (touch, np.isnan(touch.values[:, ::7])),
        }
        first = "slip" if len(slip.stamps) else "detection"
        found = [
            (int(track.stamps[row]), kind, finger)
            for kind, (track, each) in flags.items()
            for finger, column in zip(picture.fingers, each.T, strict=True)
            for row in starts(1e-9 * track.stamps, column)
            if self._seen < track.stamps[row] <= picture.shown
        ]
        for stamp, kind, finger in sorted(found, key=lambda each: (each[0], each[1] != first)):
            self._note(stamp, kind, finger, first)
            yield stamp, kind, finger, f"{finger}: {_TEXTS[kind]}".replace("_", " ")
        self._seen = picture.shown
        if self.response:
            force, joints = tracks[names.GRASP_FORCE], tracks[names.JOINT_STATES]
            torque = joints.values[:, -len(picture.joint_names) :]
            if rise := self._rise("reaction", force, force.values[:, 1]):
                yield rise, "reaction", "", "the grasp force rises"
            self._rise("torque", joints, np.linalg.norm(torque, axis=1))
            self._end(*flags[first])

    def _note(self, stamp: int, kind: str, finger: str, first: str) -> None:
        r, since = self.response, stamp - self._onset
        if kind == first and (not r or "stuck" in r or since > _RECENT):
            self.response, self._onset = {"at": 1e-9 * stamp, "finger": finger}, stamp
        elif kind == "detection" and r and since <= _RECENT:
            r.setdefault("detection", 1e-6 * since)

    def _rise(self, key: str, track: Track, values: NDArray[np.float64]) -> int:
        """Note and return the stamp, ns, of the first rise above the value at the start, or 0."""
        since = track.stamps - self._onset
        if key in self.response or not (since < 0).any():
            return 0
        limit = (1.0 + RISE) * values[since < 0][-1]
        rows = np.flatnonzero((since >= 0) & (since <= _RECENT) & (values > limit))
        if not len(rows):
            return 0
        self.response[key] = 1e-6 * int(since[rows[0]])
        return int(track.stamps[rows[0]])

    def _end(self, track: Track, flags: NDArray[np.bool_]) -> None:
        """Note when the last finger stopped, once none has slipped for a while."""
        last = track.stamps[flags.any(axis=1)]
        if len(last) and track.stamps[-1] - last[-1] > _PAUSE:
            self.response.setdefault("stuck", 1e-6 * int(last[-1] - self._onset))
