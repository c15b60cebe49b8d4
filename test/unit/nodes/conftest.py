# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of the test, without a graph."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.nodes import Process, process


@pytest.fixture
def here() -> Iterator[Process]:
    with process() as made:
        yield made
