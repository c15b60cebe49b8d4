# SPDX-License-Identifier: Apache-2.0
"""Numbers with names as compiled functions read and write them: rows of structured arrays.

Handing one array to compiled code takes a fraction of a microsecond, and writing into it nothing;
a dozen numbers that go in and out one by one take longer than what is computed with them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, flatten

Rows = NDArray[np.void]
"""Rows of named numbers, shape (n,)."""
Row = Any
"""One of them: a view, so that writing to it changes the array."""


def row_of(config: Config) -> Rows:
    """Return the real numbers of a configuration under their dotted names, shape (1,)."""
    numbers = {name: x for name, x in flatten(config).items() if isinstance(x, float)}
    return np.array([tuple(numbers.values())], dtype=[(name, np.float64) for name in numbers])
