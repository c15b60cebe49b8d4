# SPDX-License-Identifier: Apache-2.0
"""A process locks its memory and uses its stack ahead, as the kernel's own figures show."""

from __future__ import annotations

import resource
import subprocess
import sys
from types import SimpleNamespace

import pytest

from tactile_hand_ros.ros.realtime import memory

_SHOW = """
import re
from tactile_hand_ros.ros.realtime.memory import keep_heap, lock_memory, touch_stack
def kilobytes(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1])
stack = kilobytes("VmStk")
touch_stack()
keep_heap()
refused = lock_memory()
print(kilobytes("VmStk") - stack, kilobytes("VmLck"), refused)
"""
_WITHOUT_RIGHT = """
import ctypes, os, resource
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
os.setresuid(65534, 65534, 65534) if os.geteuid() == 0 else None
"""


def shown(script: str) -> tuple[int, int, str]:
    """Return by how much the stack grew [KiB], what is locked [KiB], and why it is not."""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    stack, locked, *reason = ran.stdout.split(maxsplit=2)
    return int(stack), int(locked), "".join(reason)


def test_memory_is_locked_where_that_is_permitted_and_the_stack_is_there() -> None:
    stack, locked, reason = shown(_SHOW)
    assert stack >= 200
    assert (locked > 1000) is not bool(reason)


def test_without_the_right_nothing_is_locked_and_it_says_what_to_do() -> None:
    import_first = "import tactile_hand_ros.ros.realtime.memory\n"
    _, locked, reason = shown(import_first + _WITHOUT_RIGHT + _SHOW)
    assert locked == 0
    assert "memlock" in reason


MIB = 2**20
ENDLESS = resource.RLIM_INFINITY


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ((ENDLESS, ENDLESS), (101 * MIB, ENDLESS)),
        ((50 * MIB, ENDLESS), (50 * MIB, ENDLESS)),
        ((ENDLESS, 60 * MIB), (60 * MIB, 60 * MIB)),
        ((200 * MIB, 300 * MIB), (101 * MIB, 300 * MIB)),
    ],
)
def test_memory_may_grow_by_its_room_and_no_lower_limit_is_raised(
    monkeypatch: pytest.MonkeyPatch, limits: tuple[int, int], expected: tuple[int, int]
) -> None:
    chosen: list[tuple[int, tuple[int, int]]] = []
    kernel = SimpleNamespace(
        RLIMIT_DATA=resource.RLIMIT_DATA,
        RLIM_INFINITY=ENDLESS,
        getrlimit=lambda _: limits,
        setrlimit=lambda *asked: chosen.append(asked),
    )
    monkeypatch.setattr(memory, "resource", kernel)
    monkeypatch.setattr(memory, "_data_bytes", lambda: 100 * MIB)
    memory.bound_memory(MIB)
    assert chosen == [(resource.RLIMIT_DATA, expected)]


def test_the_size_of_the_data_is_that_of_the_kernel_in_bytes() -> None:
    before = memory._data_bytes()
    block = bytearray(64 * MIB)
    assert 60 * MIB < memory._data_bytes() - before < 80 * MIB
    del block


_READ = """
import ctypes, re, threading
from tactile_hand_ros.ros.realtime.memory import bounded_memory, keep_heap, pad_heaps
def megabytes(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
library = ctypes.CDLL(None)
library.malloc.restype, library.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
taken = (ctypes.c_void_p * (6_000_000 // {size}))()
def read():
    with bounded_memory(8 * 2**20):
        for i in range(len(taken)):
            taken[i] = library.malloc({size})
        if {answered}:
            taken[-1] = None  # what an answer leaves above all the rest
        for block in taken:
            library.free(block)
before = megabytes("RssAnon")
{prepare}()
for _ in range(3):
    if {elsewhere}:
        reader = threading.Thread(target=read)
        reader.start()
        reader.join()
    else:
        read()
print(megabytes("RssAnon") - before)
"""


@pytest.mark.parametrize(
    ("prepare", "size", "answered", "elsewhere"),
    [
        ("pad_heaps", 4000, True, False),
        ("keep_heap", 4000, True, False),
        ("pad_heaps", 100, False, True),
        ("keep_heap", 100, False, True),
    ],
)
def test_what_a_request_took_is_returned(
    prepare: str, size: int, answered: bool, elsewhere: bool
) -> None:
    """Also from a second heap, in which a thread goes on whose first one may not grow."""
    given = {"prepare": prepare, "size": size, "answered": answered, "elsewhere": elsewhere}
    script = _READ.format(**given)
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(ran.stdout) < 5.0  # of the 6 that one request took


class Library:
    """A C library that notes what it is asked for, or lacks it."""

    def __init__(self, answer: int = 0) -> None:
        self.calls: list[tuple[str, int, int]] = []
        self._answer = answer

    def mlockall(self, flags: int) -> int:
        self.calls.append(("mlockall", flags, 0))
        return self._answer

    def mallopt(self, option: int, value: int) -> int:
        self.calls.append(("mallopt", option, value))
        return 1


def test_all_memory_is_locked_on_use_and_the_heap_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers are those of mlockall(2) and mallopt(3)."""
    library = Library()
    monkeypatch.setattr(memory, "_is_unlimited", lambda: True)
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda *_, **__: library)
    assert memory.lock_memory() == ""
    memory.keep_heap()
    assert library.calls == [("mlockall", 7, 0), ("mallopt", -1, -1), ("mallopt", -4, 0)]
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda *_, **__: Library(-1))
    monkeypatch.setattr(memory.ctypes, "get_errno", lambda: 12)
    assert memory.lock_memory().startswith("Cannot allocate memory: run as root")
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda *_, **__: object())
    assert memory.lock_memory() == "this system has no mlockall"
    memory.keep_heap()


@pytest.mark.parametrize(
    ("hard", "user", "unlimited", "raised"),
    [
        (ENDLESS, 1000, True, [(ENDLESS, ENDLESS)]),
        (ENDLESS, 0, True, [(ENDLESS, ENDLESS)]),
        (65536, 0, True, []),
        (65536, 1000, False, []),
    ],
)
def test_who_may_lock_memory(
    monkeypatch: pytest.MonkeyPatch, hard: int, user: int, unlimited: bool, raised: list[object]
) -> None:
    limits: list[object] = []
    monkeypatch.setattr(memory.os, "geteuid", lambda: user)
    monkeypatch.setattr(memory.resource, "getrlimit", lambda _: (4096, hard))
    monkeypatch.setattr(memory.resource, "setrlimit", lambda _, limit: limits.append(limit))
    assert memory._is_unlimited() == unlimited and limits == raised


def test_256_kib_of_the_stack_are_touched() -> None:
    assert memory.ctypes.sizeof(memory._Block) == 256 << 10


def test_a_kernel_without_the_size_of_the_data_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory.Path, "read_text", lambda *_, **__: "VmRSS: 5 kB\nVmData:\t7 kB\n")
    assert memory._data_bytes() == 7 << 10
    monkeypatch.setattr(memory.Path, "read_text", lambda *_, **__: "VmRSS: 5 kB\n")
    with pytest.raises(OSError, match="no line VmData; expected Linux"):
        memory._data_bytes()


def test_in_a_block_the_data_may_grow_by_its_room_and_then_as_before() -> None:
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with memory.bounded_memory(64 * MIB):
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        assert 60 * MIB < soft - memory._data_bytes() <= 64 * MIB and hard == before[1]
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    with pytest.raises(KeyError), memory.bounded_memory(64 * MIB):
        raise KeyError
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
