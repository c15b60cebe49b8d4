# SPDX-License-Identifier: Apache-2.0
"""A signal is not lost, whenever it comes; the life of whole processes is in test/integration."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from tactile_hand_ros.ros import runner


@pytest.fixture
def _handlers() -> Iterator[None]:
    numbers = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_before_rclpy_can_know_of_it_ends_the_process(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def init(*_: object, **__: object) -> None:
        signal.raise_signal(number)

    monkeypatch.setattr(runner.rclpy, "init", init)
    made: list[int] = []
    assert runner.run_nodes(lambda: made or made.append(1) or [], ["program"]) == 0  # type: ignore[func-returns-value]
    assert made == []
