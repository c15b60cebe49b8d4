# SPDX-License-Identifier: Apache-2.0
"""Errors of this package: one class per kind, with a common base class."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless the number is 1."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def nearest(wrong: str, valid: Sequence[str]) -> str:
    """Return the end of a sentence on a wrong name: ", did you mean 'this'?", or a full stop."""
    near = difflib.get_close_matches(wrong, valid, n=1)
    return f", did you mean '{near[0]}'?" if near else "."


def shortened(text: object, limit: int = 300) -> str:
    """Return a text in one line of at most `limit` characters."""
    line = " ".join(str(text)[:1000].split())
    return line if len(line) <= limit else f"{line[: limit - 3]}..."


class TactileHandError(Exception):
    """Base class of this package's errors, each with one sentence for the user."""


class ConfigurationError(TactileHandError):
    """An invalid configuration file or value."""


class MessageError(TactileHandError):
    """An invalid received message: wrong names, lengths, frame or NaN."""


class UnsafeOutputError(TactileHandError):
    """A result that must not be published: not finite, or outside its configured limits."""


class HandModelError(TactileHandError):
    """A hand that cannot be built from its URDF and YAML."""


class DivergedError(TactileHandError):
    """A simulation that has diverged, so its numbers are meaningless."""


class ObjectModelError(TactileHandError):
    """An object that cannot be simulated."""


class GraspError(TactileHandError):
    """A grasp that the method cannot handle."""


class CollinearContactsError(GraspError):
    """Collinear contacts: the rotation about their line is undetermined (assumption A7)."""

    @classmethod
    def of(cls, points: Iterable[Iterable[float]]) -> CollinearContactsError:
        """Return the error for these contact points."""
        listed = ", ".join("(" + ", ".join(f"{x:.4f}" for x in p) + ")" for p in points)
        return cls(
            f"the contacts {listed} lie on one line (A7); a grasp needs three contacts that are "
            "not collinear: move a finger off the line"
        )


class PoseError(TactileHandError):
    """A desired pose that the hand cannot reach."""


class BagError(TactileHandError):
    """A bag that cannot be written or read, with the reason and the remedy."""
