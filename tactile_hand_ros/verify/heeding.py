# SPDX-License-Identifier: Apache-2.0
"""At which tick was a wish heeded? The bag knows when it was said, the answers tell the rest."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from tactile_hand_ros.verify.recorded_inputs import UserCommand

Act = Callable[[int], None]


class Heeding:
    """Steps a block through a recording and gives it the wishes of users where they belong.

    Where a wish may have been heeded at several ticks, copies of the block are kept. As soon as an
    answer differs from the recorded one, and at the last of those ticks, all ticks since are
    answered again with the wish heeded at each of them, nearest to its place in the bag first,
    until all answers agree.
    """

    def __init__(
        self,
        block: Any,
        wishes: list[UserCommand],
        heed: Callable[[Any, UserCommand], None],
        agrees: Callable[[int], bool],
    ) -> None:
        """Start before the first tick.

        Args:
            block: What has a state and is stepped.
            wishes: In order; those of unknown tick get the one that was found.
            heed: Gives the block a wish.
            agrees: Tells whether the answer at a row is as recorded.
        """
        self.block = block
        self._wishes = list(wishes)
        self._heed, self._agrees = heed, agrees
        self._copies: dict[int, Any] = {}
        self._acts: list[tuple[int, Act]] = []

    def step(self, row: int, act: Act) -> None:
        """Answer a tick.

        Args:
            row: Its row.
            act: Steps `block` and writes down the answer; called again for another try.
        """
        while self._wishes and self._wishes[0].certain and self._wishes[0].last <= row:
            self._heed(self.block, self._wishes.pop(0))
        while len(self._wishes) > 1 and self._acts and self._wishes[1].first <= row:
            self._settle()
        if not self._wishes or self._wishes[0].first > row:
            act(row)
            return
        last = self._wishes[0].last
        if row <= last or not self._copies:  # the latter after a silence
            self._copies[row] = self._copy(self.block)
        self._acts.append((row, act))
        act(row)
        # Past its last tick a wish that made no difference is not the reason of later ones.
        if row >= last or not self._agrees(row):
            self._search()

    def finish(self) -> None:
        """Give what made no difference its likely tick."""
        while self._wishes and self._acts:
            self._settle()

    def _search(self) -> None:
        """Take the tick that explains all answers so far."""
        wish = self._wishes[0]
        for row in sorted(self._copies, key=lambda row: abs(row - wish.guess)):
            if self._again(row, wish, insist=True):
                self._found(row)
                return
        self._settle()  # something else differs, too

    def _settle(self) -> None:
        """Take the likely tick, though it does not explain the answers."""
        self._found(min(self._copies, key=lambda row: abs(row - self._wishes[0].guess)))

    def _again(self, start: int, wish: UserCommand | None, *, insist: bool) -> bool:
        """Answer the ticks from a row on once more; stop at the first that does not agree."""
        self.block = self._copy(self._copies[start])
        if wish is not None:
            self._heed(self.block, wish)
        for row, act in self._acts:
            if row >= start:
                act(row)
                if insist and not self._agrees(row):
                    return False
        return True

    def _found(self, row: int) -> None:
        """Answer everything once more: other tries have written over the ticks before."""
        wish = self._wishes.pop(0)
        self._again(min(self._copies), None, insist=False)
        self._again(row, wish, insist=False)
        wish.first = wish.last = row
        self._copies.clear()
        self._acts.clear()

    @staticmethod
    def _copy(block: Any) -> Any:
        hand = getattr(block, "hand", None)  # a model, not a state
        return copy.deepcopy(block, {id(hand): hand} if hand is not None else {})
