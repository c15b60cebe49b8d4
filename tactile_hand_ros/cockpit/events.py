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
from tactile_hand_ros.run.events import SLIDING

_PAUSE = 20_000_000  # ns; a shorter pause does not split a slip
_RISE = 1.02  # of the grasp force, that counts as a reaction
_RECENT = 250_000_000  # ns after the start of a slip in which an alarm belongs to it

Flags = NDArray[np.bool_]


class Watch:
    """Finds events in each batch of a picture.

    Attributes:
        response: Milliseconds from the start of the newest slip to ``detection``, ``reaction`` and
            ``stuck``, with ``finger`` and the time ``at``, s; empty before the first slip.
    """

    def __init__(self) -> None:
        """Start without events."""
        self.response: dict[str, Any] = {}
        self._last: dict[tuple[str, int], tuple[bool, int]] = {}
        self._onset, self._force = 0, np.inf

    def step(self, picture: Picture) -> Iterator[dict[str, Any]]:
        """Yield the events of the newest batch, each ``time``, ``kind``, ``finger``, ``text``."""
        tracks, k = picture.tracks, len(picture.fingers)
        found = [
            *_rising(tracks[names.TRUE_SLIP], lambda v: v > SLIDING, "slip", self._last),
            *_rising(
                tracks[names.GRIP_STATE],
                lambda v: v[:, k:] == ContactState.SLIP,
                "detection",
                self._last,
            ),
            *_rising(
                tracks[names.CONTACTS],
                lambda v: np.isnan(v[:, ::7]),
                "contact_lost",
                self._last,
            ),
        ]
        for stamp, kind, finger in sorted(found):
            self._note(stamp, kind, picture.fingers[finger])
            text = f"{picture.fingers[finger]}: {_TEXTS[kind]}".replace("_", " ")
            yield _event(stamp, kind, picture.fingers[finger], text)
        yield from self._reaction(tracks[names.GRASP_FORCE])
        self._end(tracks[names.TRUE_SLIP])

    def _note(self, stamp: int, kind: str, finger: str) -> None:
        """Start a response at a slip, or at an alarm where there is no ground truth."""
        r = self.response
        if kind == "slip" and (not r or "stuck" in r or stamp - self._onset > _RECENT):
            self.response = {"at": 1e-9 * stamp, "finger": finger}
            self._onset, self._force = stamp, np.inf
        elif kind == "detection" and r and "detection" not in r:
            r["detection"] = 1e-6 * (stamp - self._onset)

    def _reaction(self, force: Track) -> Iterator[dict[str, Any]]:
        r = self.response
        if not r or "reaction" in r or not force.new:
            return
        before = force.values[force.stamps <= self._onset, 1]
        if np.isinf(self._force) and len(before):
            self._force = before[-1]
        new = slice(-force.new, None)
        rows = np.flatnonzero(force.values[new, 1] > _RISE * self._force)
        if len(rows):
            stamp = int(force.stamps[new][rows[0]])
            r["reaction"] = 1e-6 * (stamp - self._onset)
            yield _event(stamp, "reaction", "", "the grasp force rises")

    def _end(self, slip: Track) -> None:
        r = self.response
        if not r or "stuck" in r or not slip.new:
            return
        last = max(at for (kind, _), (_, at) in self._last.items() if kind == "slip")
        if slip.stamps[-1] - last > _PAUSE:
            r["stuck"] = 1e-6 * (last - self._onset)


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
