# SPDX-License-Identifier: Apache-2.0
"""Injection of each fault from outside: signals, limits, load and messages."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np
from std_msgs.msg import Float64

from studies.faults import space
from studies.faults.running_hand import RunningHand
from studies.faults.space import Injection
from tactile_hand_ros import names
from tactile_hand_ros.ros.messages import PoseCodec

_NODE_OF = {
    space.SENSOR: names.SENSOR,
    space.REGULATOR: names.REGULATOR,
    space.OPTIMIZER: names.OPTIMIZER,
    space.CONTROLLER: names.CONTROLLER,
    space.RECORDER: names.RECORDER,
}
_BUSY = "while True: pass"
_LOOPS_PER_CORE = 2
_FLOOD = 0.002  # s between two bursts of user commands
_JUMP = 0.05  # m
_STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def injected(hand: RunningHand, run: Injection) -> AbstractContextManager[None]:
    """Inject a fault for the duration of the block."""
    if run.fault == space.NONE:
        return nullcontext()
    if run.component == space.USER:
        return _user(hand, run)
    if run.fault == "starved":
        return _busy(_LOOPS_PER_CORE * (os.cpu_count() or 1))
    if run.component == space.COMPUTER:
        return _stopped([p.pid for name, p in hand.processes.items() if name != names.PLANT])
    name = _NODE_OF[run.component]
    if run.fault == "off":
        return _killed(hand, name)
    pid = hand.processes[name].pid
    return _no_more_space(pid) if run.fault == "full disk" else _stopped([pid])


@contextmanager
def _killed(hand: RunningHand, name: str) -> Iterator[None]:
    process = hand.processes[name]
    process.send(signal.SIGKILL)
    process.wait()
    yield
    hand.start(name)


@contextmanager
def _stopped(pids: list[int]) -> Iterator[None]:
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)


@contextmanager
def _no_more_space(pid: int) -> Iterator[None]:
    """Make every write beyond the current end of a file fail, as on a full disk."""
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


@contextmanager
def _busy(loops: int) -> Iterator[None]:
    made = [subprocess.Popen([sys.executable, "-S", "-c", _BUSY]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in made:
            process.kill()
            process.wait()


@contextmanager
def _user(hand: RunningHand, run: Injection) -> Iterator[None]:
    """Send invalid user commands from a thread."""
    over = threading.Event()
    send = _sender(hand, run)

    def keep_sending() -> None:
        while not over.wait(_FLOOD):
            send()

    thread = threading.Thread(target=keep_sending)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _sender(hand: RunningHand, run: Injection) -> Callable[[], None]:
    """Return a function that sends one burst of faulty user commands."""
    codec, chance, fault = PoseCodec(), random.Random(run.seed), run.fault
    _, seen = hand.positions(hand.since(time.monotonic() - 1.0))
    here = seen[-1]

    def send() -> None:
        if fault == "garbage":
            hand.poses.publish(b"\0\1\0\0" + chance.randbytes(80))
            return
        jumps = [chance.uniform(-_JUMP, _JUMP) for _ in range(3)]
        away = {"wrong": 10.0, "intermittent": np.array(jumps)}.get(fault, 0.0)
        hand.poses.publish(codec.encode(here + away, _STRAIGHT, int(fault == "delayed")))
        if fault == "wrong":
            hand.grasp_forces.publish(Float64(data=chance.choice([-1.0, 1e6, float("nan")])))

    return send
