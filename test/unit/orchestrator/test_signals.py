# SPDX-License-Identifier: Apache-2.0
"""Signals that come at the worst moment of a wait."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from tactile_hand_ros.orchestrator.signals import Interrupted, Signals, pause

FLOOD = """
import os, signal, threading
from tactile_hand_ros.orchestrator.signals import Interrupted, Signals

signals = Signals()
signals.install()

pause = threading.Event()

def send():
    for _ in range(5000):
        os.kill(os.getpid(), signal.SIGINT)
        pause.wait(2e-5)

sender = threading.Thread(target=send)
sender.start()
woken = 0
while sender.is_alive():
    signals.count = 0
    try:
        signals.wait(1e-5)
    except Interrupted:
        woken += 1
print(woken)
"""


def test_wait_without_a_signal_lasts_as_long_as_it_should_and_says_nothing() -> None:
    """It is a pause, one after the other."""
    signals = Signals()
    for _ in range(2):
        began = time.monotonic()
        signals.wait(0.01)
        assert 0.01 <= time.monotonic() - began < 5.0
    signals.check()
    assert (signals.number, signals.count, signals.name) == (0, 0, "")


def test_wait_ends_with_the_signal_that_comes_meanwhile_and_the_first_one_counts() -> None:
    """Whatever comes later does not change why the run ends."""
    signals = Signals()
    sender = threading.Timer(0.01, signals._note, (signal.SIGTERM, None))
    sender.start()
    with pytest.raises(Interrupted, match="ended by SIGTERM"):
        signals.wait(1000.0)
    sender.join()
    signals._note(signal.SIGINT, None)
    with pytest.raises(Interrupted, match="ended by SIGTERM"):
        signals.check()
    assert (signals.count, signals.exit_code) == (2, 143)


def test_wait_after_a_signal_raises_at_once() -> None:
    """Also again and again: the wish to end does not wear off."""
    signals = Signals()
    signals._note(2, None)
    for _ in range(3):
        with pytest.raises(Interrupted, match="SIGINT"):
            signals.wait(1000.0)
    assert signals.exit_code == 130


def test_signals_at_any_moment_of_a_wait_do_not_lock_it() -> None:
    """A handler runs between any two steps of the wait; what both use must bear that."""
    result = subprocess.run(
        [sys.executable, "-c", FLOOD], capture_output=True, text=True, timeout=60.0
    )
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) > 0


@pytest.mark.parametrize("ignored", [[], [signal.SIGHUP], [signal.SIGINT, signal.SIGTERM]])
def test_all_three_signals_are_watched_but_a_hangup_that_is_to_be_ignored(
    monkeypatch: pytest.MonkeyPatch, ignored: list[int]
) -> None:
    handlers: dict[int, object] = {}
    monkeypatch.setattr(
        signal, "getsignal", lambda number: signal.SIG_IGN if number in ignored else None
    )
    monkeypatch.setattr(signal, "signal", handlers.__setitem__)
    signals = Signals()
    signals.install()
    monkeypatch.undo()
    left = {signal.SIGHUP} & set(ignored)
    assert set(handlers) == {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} - left
    assert set(handlers.values()) == {signals._note} and (signals.number, signals.count) == (0, 0)


def test_a_pause_lasts_as_long_as_it_should() -> None:
    began = time.monotonic()
    pause(0.02)
    assert 0.0199 < time.monotonic() - began < 1.0
