# SPDX-License-Identifier: Apache-2.0
"""What was known shortly before: that touch is wrong shows only after some ticks of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

Known = TypeVar("Known")

AGE = 20_000_000
"""What is gone back to is at least so old, where there is something, and at most twice [ns]."""


class Checkpoints(Generic[Known]):
    """Keeps two states of something that learns, `AGE` apart."""

    def __init__(self) -> None:
        """Start without a past."""
        self.forget()

    def forget(self) -> None:
        """Forget the past: time or grasp are new."""
        self._kept: list[tuple[int, Known]] = []

    def pass_by(self, stamp: int, known: Callable[[], Known]) -> None:
        """Keep what is known at a tick [ns], when the newest state is old enough."""
        if not self._kept or stamp - self._kept[-1][0] >= AGE:
            self._kept = [*self._kept[-1:], (stamp, known())]

    @property
    def before(self) -> Known | None:
        """What was known shortly before; None without a past."""
        return self._kept[0][1] if self._kept else None
