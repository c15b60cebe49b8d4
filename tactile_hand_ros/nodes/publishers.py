# SPDX-License-Identifier: Apache-2.0
"""Notices a second publisher of a topic that has one owner."""

from __future__ import annotations

from typing import Any

from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.node import TactileNode


def report_publishers(node: TactileNode[Any], topic: str) -> None:
    """Warn in the diagnostics while a topic has more than one publisher.

    A publisher that was killed counts until the middleware gives it up, after some seconds.
    """
    count = node.count_publishers(topic)
    node.diagnostics.judge(
        f"publishers of {topic}",
        count > 1,
        f"{count} publishers of {topic}, expected one; two hands need two namespaces",
        WARN,
    )
