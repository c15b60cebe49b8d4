# SPDX-License-Identifier: Apache-2.0
"""The command `tactile-hand`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; handle a Ctrl-C during loading like `app.main`."""
    try:
        from tactile_hand_ros.cli import app

        return app.main(arguments)
    except KeyboardInterrupt:
        print("tactile-hand: interrupted.", file=sys.stderr)
        return 130
