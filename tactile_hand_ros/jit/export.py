# SPDX-License-Identifier: Apache-2.0
"""Turn what Numba has compiled into `Code`, which can be loaded without Numba."""

from __future__ import annotations

import pickle
import platform
import sys
from typing import Any, NamedTuple

import numpy as np

from tactile_hand_ros.jit.machine_code import ENVIRONMENT, Code, address_of

_SECTION = np.dtype(
    [("name", "<u4"), ("type", "<u4"), ("flags", "<u8"), ("address", "<u8"), ("offset", "<u8"),
     ("size", "<u8"), ("link", "<u4"), ("info", "<u4"), ("align", "<u8"), ("each", "<u8")]
)  # fmt: skip
_SYMBOL = np.dtype(
    [("name", "<u4"), ("info", "u1"), ("other", "u1"), ("section", "<u2"), ("value", "<u8"),
     ("size", "<u8")]
)  # fmt: skip
_RELOCATION = np.dtype([("place", "<u8"), ("type", "<u4"), ("symbol", "<u4"), ("addend", "<i8")])

_CONTENTS, _SYMBOLS, _RELOCATIONS = 1, 2, 4  # types of sections
_WRITTEN, _LOADED = 1, 2  # their flags
_COMMON = (0xFFF2, 0xFF02)  # sections of what only has a size, here the pointers to environments
_ADDRESS = 1  # R_X86_64_64, the only one in code for any place in memory
_NUMBA_ENVIRONMENT = "_ZN08NumbaEnv"


class UnknownCodeError(ValueError):
    """Machine code that cannot be loaded without Numba, such as that of another processor."""


def is_exportable() -> bool:
    """Return whether this computer runs code that can be loaded without Numba."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def export(dispatcher: Any) -> Code:
    """Return the machine code of a function that Numba has compiled for one kind of arguments.

    Where there are several, the one without views and literals counts: others come from compiled
    functions. One that compiled functions alone call, with literals, may be any of them.

    Raises:
        UnknownCodeError: If it is unclear which, or for code of an unknown sort.
    """
    kinds = list(dispatcher.overloads.values())
    if len(kinds) > 1:
        kinds = [made for made in kinds if not _takes_views(made)]
        kinds = [made for made in kinds if not _takes_literals(made)] or kinds[:1]
    if len(kinds) != 1:
        raise UnknownCodeError(f"{dispatcher} is compiled for {len(kinds)} kinds of arguments")
    (compiled,) = kinds
    library, description, environment, *_, others = compiled._reduce()
    _, _, (object_code, _) = library
    constants = {env.env_name: list(env.consts) for env in (environment, *others)}
    return _linked(_Elf.of(object_code), description.llvm_cpython_wrapper_name, constants)


def _takes_views(compiled: Any) -> bool:
    return any(getattr(kind, "layout", "C") != "C" for kind in compiled.signature.args)


def _takes_literals(compiled: Any) -> bool:
    return any(hasattr(kind, "literal_value") for kind in compiled.signature.args)


class _Elf(NamedTuple):
    """An object file: its bytes, sections, symbols and their names."""

    data: bytes
    sections: np.ndarray
    symbols: np.ndarray
    names: list[str]

    @classmethod
    def of(cls, data: bytes) -> _Elf:
        if not is_exportable() or data[:5] != b"\x7fELF\x02":
            raise UnknownCodeError("not code for Linux on x86-64")
        start = int.from_bytes(data[0x28:0x30], "little")
        count = int.from_bytes(data[0x3C:0x3E], "little")
        sections = np.frombuffer(data, _SECTION, count, start)
        (table,) = sections[sections["type"] == _SYMBOLS]
        symbols = np.frombuffer(data, _SYMBOL, int(table["size"]) // 24, int(table["offset"]))
        texts = int(sections[table["link"]]["offset"])
        first = [texts + int(name) for name in symbols["name"]]
        names = [data[at : data.index(b"\0", at)].decode() for at in first]
        return cls(data, sections, symbols, names)


def _linked(elf: _Elf, entry: str, constants: dict[str, list[Any]]) -> Code:
    """Lay sections and pointers to environments out one after the other."""
    image, begins = _image(elf)
    names: list[str] = []
    places: list[tuple[int, int, int]] = []
    pointers: dict[int, int] = {}  # where the image has the variable of a symbol
    for index in np.flatnonzero(np.isin(elf.symbols["section"], _COMMON)).tolist():
        name = elf.names[index]
        pointers[index] = len(image)
        if name in constants:  # Numba forgets those that are not used
            places.append((len(image), len(names), 0))
            names.append(ENVIRONMENT + name)
        elif not name.startswith(_NUMBA_ENVIRONMENT):
            raise UnknownCodeError(f"code with the variable {name}")
        image.extend(bytes(8))
    for place, index, addend in _relocations(elf, begins):
        section, value = int(elf.symbols[index]["section"]), int(elf.symbols[index]["value"])
        if index in pointers:
            places.append((place, -1, pointers[index] + addend))
        elif section in begins:
            places.append((place, -1, begins[section] + value + addend))
        else:
            places.append((place, _index_of(elf.names[index], names), addend))
    start = elf.symbols[elf.names.index(entry)]
    at, whose, added = np.array(places, dtype=np.int64).reshape(-1, 3).T.copy()
    begin = begins[int(start["section"])] + int(start["value"])
    return Code(bytes(image), begin, at, whose, added, tuple(names), pickle.dumps(constants))


def _image(elf: _Elf) -> tuple[bytearray, dict[int, int]]:
    """Return code and constants one after the other, and where each section begins."""
    image, begins = bytearray(), {}
    unwinding = _indices_of(elf, ".eh_frame")
    for index, section in enumerate(elf.sections):
        if not section["flags"] & _LOADED or not section["size"] or index in unwinding:
            continue
        if section["flags"] & _WRITTEN or section["type"] != _CONTENTS:
            raise UnknownCodeError("code with variables of its own")
        image.extend(bytes(-len(image) % max(64, int(section["align"]))))
        begins[index] = len(image)
        offset = int(section["offset"])
        image.extend(elf.data[offset : offset + int(section["size"])])
    image.extend(bytes(-len(image) % 64))
    return image, begins


def _index_of(symbol: str, names: list[str]) -> int:
    """Return the index of a symbol outside, which is added where it is new.

    Raises:
        UnknownCodeError: If it is nowhere.
    """
    if symbol not in names:
        try:
            address_of(symbol)
        except LookupError as error:
            raise UnknownCodeError(str(error)) from None
        names.append(symbol)
    return names.index(symbol)


def _indices_of(elf: _Elf, name: str) -> set[int]:
    start = int(elf.sections[int.from_bytes(elf.data[0x3E:0x40], "little")]["offset"])
    text = name.encode() + b"\0"
    return {
        index
        for index, section in enumerate(elf.sections)
        if elf.data.startswith(text, start + int(section["name"]))
    }


def _relocations(elf: _Elf, begins: dict[int, int]) -> list[tuple[int, int, int]]:
    """Return where in the image which symbol's address belongs, and what is added to it."""
    out = []
    for section in elf.sections[elf.sections["type"] == _RELOCATIONS]:
        begin = begins.get(int(section["info"]))
        if begin is None:
            continue
        count, offset = int(section["size"]) // 24, int(section["offset"])
        for entry in np.frombuffer(elf.data, _RELOCATION, count, offset):
            if entry["type"] != _ADDRESS:
                raise UnknownCodeError(f"code with relocations of type {entry['type']}")
            out.append((begin + int(entry["place"]), int(entry["symbol"]), int(entry["addend"])))
    return out
