# SPDX-License-Identifier: Apache-2.0
"""What every test may rely on, however the suite was started."""

import resource
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# `bench` and `studies` stand beside the package; behind it, so that what is installed is tested.
sys.path.append(str(Path(__file__).resolve().parents[1]))

# MuJoCo needs a newer Python than the package does.
_MUJOCO = ["unit/simulation/test_mujoco_plant.py", "unit/hand/test_mjcf.py"]
collect_ignore = _MUJOCO if sys.version_info < (3, 11) else []

# No test fails on a duration; the first call of a compiled function may take a second.
settings.register_profile("patient", deadline=None)
settings.register_profile("fuzz", deadline=None, max_examples=20_000)
settings.load_profile("patient")


def pytest_configure() -> None:
    """Let child processes be interrupted: in a shell's background jobs SIGINT is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def handlers() -> Iterator[None]:
    """Restore the handlers of the signals that end a process."""
    ending = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in ending}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def hangups_count(handlers: None) -> None:
    """Let SIGHUP end a process, also below nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture
def small_disk() -> Iterator[int]:
    """Limit this process to files of 100 kB, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    yield 100_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    signal.signal(signal.SIGXFSZ, handler)


@pytest.fixture(scope="module", autouse=True)
def _no_shared_memory() -> Iterator[None]:
    """Insist on sockets: processes that tests kill would leave traps in shared memory."""
    yield
    assert "/dev/shm/fastrtps" not in Path("/proc/self/maps").read_text()


@pytest.fixture
def domain() -> Iterator[int]:
    """Reserve a ROS domain."""
    from bench.processes import isolated_domain

    with isolated_domain() as number:
        yield number


def _context(domain: int) -> Iterator[Any]:
    """A ROS context in a domain of its own; `there` is another one in the same domain."""
    from tactile_hand_ros.ros.middleware import ros_context

    with ros_context(domain=domain) as made:
        yield made


context, there = pytest.fixture(_context, name="context"), pytest.fixture(_context, name="there")


@pytest.fixture
def here() -> Iterator[Any]:
    """A process of the test with a user, in a domain of its own; see `support.nodes.Process`."""
    from support.nodes import process

    with process() as made:
        yield made
