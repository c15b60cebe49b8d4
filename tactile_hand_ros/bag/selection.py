# SPDX-License-Identifier: Apache-2.0
"""Choice of topics by name."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tactile_hand_ros.errors import ConfigurationError


class TopicSelection:
    """Decides by name which topics are recorded."""

    def __init__(self, include: Sequence[str], exclude: Sequence[str] = ()) -> None:
        """Compile the patterns.

        Args:
            include: Regular expressions, one of which must match the whole name.
            exclude: Regular expressions, none of which may match the whole name.

        Raises:
            ConfigurationError: If one is not valid.
        """
        try:
            self._include = [re.compile(pattern) for pattern in include]
            self._exclude = [re.compile(pattern) for pattern in exclude]
        except re.error as error:
            text = f"'{error.pattern!s}' is not a valid regular expression: {error}."
            raise ConfigurationError(text) from None

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic, given by its full name, is chosen; hidden ones never are."""
        is_hidden = any(part.startswith("_") for part in topic.split("/"))
        if is_hidden or any(pattern.fullmatch(topic) for pattern in self._exclude):
            return False
        return any(pattern.fullmatch(topic) for pattern in self._include)
