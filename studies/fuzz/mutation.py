# SPDX-License-Identifier: Apache-2.0
"""Damage to good inputs, by a seed."""

from __future__ import annotations

import random
import struct

_WORDS = (
    *(b"", b"\0", b"\xff", bytes(4), bytes(8), b"\xff" * 4, b"\xff" * 8, b"\xff\xff\xff\x7f"),
    *(struct.pack("<d", value) for value in (1e308, -1e308, float("nan"), float("inf"), 5e-324)),
    *(struct.pack("<I", value) for value in (1, 2**16, 2**20, 2**31, 2**32 - 1)),
)
_TEXTS = (
    *("", "~", "[", "]", "{}", "[]", "&a [*a]", "*a", "!!python/object:os.system ''", "? [a]"),
    *("\0", "\\", "..", "-1", "0", ".nan", ".inf", "1e308", "-1e308", "1e-320", "9" * 400, "'"),
    *("0x" + "f" * 500, "1:1:1", "2024-13-01", "true", '"', "<", ">", "\x85", "\u2028", "---"),
    *("%YAML 9.9", "- " * 200, "[" * 3000, "{a: " * 3000, "\udcff", "nan", "  ", "\t", "plant:"),
)
_LONGEST = 2**18  # bytes


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Return bytes with one to five damages: overwritten, inserted, cut out, repeated, random."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 5)):
        at, size = chance.randint(0, len(changed)), chance.randint(0, 40)
        word = chance.choice(_WORDS) or chance.randbytes(size)
        what = chance.randrange(5)
        if what == 0:
            changed[at : at + len(word)] = word
        elif what == 1:
            changed[at:at] = word
        elif what == 2:
            del changed[at : at + size]
        elif what == 3:
            changed[at:at] = changed[max(0, at - size) : at] * chance.randint(1, 4)
        else:
            del changed[at:]
    return bytes(changed[:_LONGEST])


def damaged_text(text: str, chance: random.Random) -> bytes:
    """Return a text in which some words are others, more or fewer, as it is written to a file."""
    words = text.split(" ")
    for _ in range(chance.randint(1, 4)):
        at, what = chance.randrange(len(words)), chance.randrange(5)
        if what == 0:
            words[at] = chance.choice(_TEXTS)
        elif what == 1:
            words.insert(at, chance.choice(_TEXTS))
        elif what == 2:
            del words[at : at + chance.randint(1, 20)]
        elif what == 3:
            words[at:at] = words[at : at + 20] * chance.randint(1, 9)
        else:
            words[at] = words[at].replace("\n", chance.choice(("", " ", "\n\n", "\n - ")))
        words = words or [""]
    return " ".join(words).encode("utf-8", "surrogatepass")[:_LONGEST]
