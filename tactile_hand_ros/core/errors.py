# SPDX-License-Identifier: Apache-2.0
"""The failures this package can name: one class per kind, all below one base."""

from __future__ import annotations


class TactileHandError(Exception):
    """Base of every error that this package raises on purpose.

    Its text is one sentence for the user: what was got, what was expected, what to do.
    """


class ConfigurationError(TactileHandError):
    """A configuration file or value that cannot be used.

    Attributes:
        source: File or interface the value came from, empty when unknown.
        place: Dotted key inside the source, empty when the whole source is meant.
    """

    def __init__(self, message: str, *, source: str = "", place: str = "") -> None:
        """Keep the place beside the sentence."""
        super().__init__(message)
        self.source = source
        self.place = place


class MessageError(TactileHandError):
    """A message from outside that cannot be used: wrong names, lengths, frame or NaN."""
