# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of the test, without a graph."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from tactile_hand_ros.ros.domains import isolated_domain, private_context


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture
def make(context: Any) -> Iterator[Callable[..., Any]]:
    made: list[Any] = []

    def _make(kind: type[Node], **parameters: Any) -> Any:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        made.append(kind(context=context, parameter_overrides=overrides))
        return made[-1]

    yield _make
    for node in made:
        node.close()
        node.destroy_node()
