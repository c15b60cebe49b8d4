# SPDX-License-Identifier: Apache-2.0
"""Selection of topics by name."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tactile_hand_ros.errors import ConfigurationError


class TopicSelection:
    """A selection of topics by regular expressions on their names."""

    def __init__(self, include: Sequence[str], exclude: Sequence[str] = ()) -> None:
        """Compile the patterns: one `include` and no `exclude` must match the whole name.

        Raises:
            ConfigurationError: If a pattern is invalid.
        """
        try:
            self._include = [re.compile(pattern) for pattern in include]
            self._exclude = [re.compile(pattern) for pattern in exclude]
        except re.error as error:
            text = f"'{error.pattern!s}' is not a valid regular expression: {error}."
            raise ConfigurationError(text) from None

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is selected, by its full name; hidden topics never are."""
        is_hidden = any(part.startswith("_") for part in topic.split("/"))
        if is_hidden or any(pattern.fullmatch(topic) for pattern in self._exclude):
            return False
        return any(pattern.fullmatch(topic) for pattern in self._include)
