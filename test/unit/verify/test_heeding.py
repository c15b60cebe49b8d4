# SPDX-License-Identifier: Apache-2.0
"""Wishes of unknown tick, given to a block that adds up what it is asked for."""

from __future__ import annotations

from tactile_hand_ros.verify.heeding import Heeding
from tactile_hand_ros.verify.recorded_inputs import UserCommand


class Adder:
    """Answers each tick with a value that grows by the step that was last asked for."""

    def __init__(self) -> None:
        """Begin at zero with steps of one."""
        self.value, self.step = 0, 1


class Replay:
    """A recording of an adder, answered once more."""

    def __init__(self, rows: list[int], heeded: dict[int, int], wishes: list[UserCommand]) -> None:
        """Record `rows` with the steps asked for at some of them."""
        self.rows, self.recorded, self.answers = rows, dict[int, int](), dict[int, int]()
        self.acts = 0
        block = Adder()
        for row in rows:
            block.step = heeded.get(row, block.step)
            block.value += block.step
            self.recorded[row] = block.value
        self.wishes = wishes
        self.heeding = Heeding(Adder(), wishes, self._heed, self._agrees)

    def run(self) -> None:
        """Answer all rows."""
        for row in self.rows:
            self.heeding.step(row, self._act)
        self.heeding.finish()

    def _act(self, row: int) -> None:
        self.acts += 1
        block = self.heeding.block
        block.value += block.step
        self.answers[row] = block.value

    def _agrees(self, row: int) -> bool:
        return self.answers[row] == self.recorded[row]

    @staticmethod
    def _heed(block: Adder, wish: UserCommand) -> None:
        block.step = wish.value


def test_tick_is_found() -> None:
    """The one with which all answers agree."""
    replay = Replay(list(range(60)), {23: 5}, [UserCommand(5, 0, 10, 40, 30)])
    replay.run()
    assert replay.answers == replay.recorded
    assert (replay.wishes[0].first, replay.wishes[0].last) == (23, 23)


def test_wish_during_a_silence_is_heeded_after_it() -> None:
    """The block is not stepped at any tick at which the wish may have come, changing or not."""
    rows = [*range(10), *range(50, 90)]
    for value in (5, 1):
        replay = Replay(
            rows, {50: value}, [UserCommand(value, 0, 15, 40, 30), UserCommand(7, 0, 85, 89, 87)]
        )
        replay.run()
        assert {row: replay.answers[row] for row in range(50, 85)} == {
            row: replay.recorded[row] for row in range(50, 85)
        }
        assert replay.wishes[0].first == 50


def test_wish_that_changes_nothing_costs_nothing_later() -> None:
    """It is settled when its window is over: a difference much later is not its doing."""
    replay = Replay(list(range(2000)), {1900: 9}, [UserCommand(1, 0, 10, 40, 30)])
    replay.run()
    assert replay.wishes[0].first == 30
    assert replay.acts < 2200
