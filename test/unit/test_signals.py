# SPDX-License-Identifier: Apache-2.0
"""Signals at the worst moment of a wait."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from tactile_hand_ros.command_line import Interrupted, Signals

FLOOD = """
import os, signal, threading
from tactile_hand_ros.command_line import Interrupted, Signals

signals, pause = Signals().install(), threading.Event()

def send():
    for _ in range(5000):
        os.kill(os.getpid(), signal.SIGINT)
        pause.wait(2e-5)

sender = threading.Thread(target=send)
sender.start()
woken = 0
while sender.is_alive():
    signals.number = 0
    try:
        signals.wait(1e-5)
    except Interrupted:
        woken += 1
print(woken)
"""


@pytest.fixture
def signals(hangups_count: None) -> Signals:
    """Return signals that are installed for the duration of the test."""
    return Signals().install()


def test_a_wait_without_a_signal_lasts_as_long_as_it_should(signals):
    for _ in range(2):
        start = time.monotonic()
        signals.wait(0.01)
        assert 0.01 <= time.monotonic() - start < 5.0
    signals.check()
    assert (signals.number, signals.name) == (0, "")


def test_a_wait_ends_with_the_signal_and_the_first_one_counts(signals):
    sender = threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGTERM))
    sender.start()
    with pytest.raises(Interrupted, match="ended by SIGTERM"):
        signals.wait(1000.0)
    sender.join()
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(3):  # repeatedly
        with pytest.raises(Interrupted, match="ended by SIGTERM"):
            signals.wait(1000.0)
    assert (signals.number, signals.exit_code) == (signal.SIGTERM, 143)


def test_a_hangup_that_is_ignored_stays_so(signals):
    """As for nohup; an ignored SIGINT is handled all the same, because it ends a run."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signals.install()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(Interrupted, match="SIGINT"):
        signals.check()


def test_signals_at_any_moment_of_a_wait_do_not_lock_it():
    """A handler may run between any two steps of the wait, so shared state must tolerate it."""
    result = subprocess.run(
        [sys.executable, "-c", FLOOD], capture_output=True, text=True, timeout=60.0
    )
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) > 0
