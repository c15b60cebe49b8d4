# SPDX-License-Identifier: Apache-2.0
"""Arrays as text that a page can carry: little-endian numbers in base64."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CODES = {"f4": "<f4", "f8": "<f8", "u1": "u1"}


def pack(array: NDArray[Any], code: str = "f4") -> dict[str, Any]:
    """Return an array as plain data for JSON.

    Args:
        array: Numbers of any shape.
        code: ``f4`` or ``f8``, or ``u1`` for whole numbers up to 254, in which NaN becomes 255.
    """
    values = np.asarray(array)
    if code == "u1":
        values = np.where(np.isnan(values), 255, values)
    data = np.ascontiguousarray(values, dtype=_CODES[code]).tobytes()
    return {
        "type": code,
        "shape": list(values.shape),
        "data": base64.b64encode(data).decode("ascii"),
    }
