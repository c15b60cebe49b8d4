# SPDX-License-Identifier: Apache-2.0
"""The diagrams of docs/architecture.md are those of the code; the traced ones name real modules."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")


@pytest.fixture(scope="module")
def draw() -> ModuleType:
    """Load the script that draws; it is no part of the package."""
    path = ROOT / "docs" / "draw_architecture.py"
    spec = importlib.util.spec_from_file_location("draw_architecture", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def diagram(name: str) -> str:
    found = re.search(rf"<!-- drawn: {name} -->\n(.*?)\n<!-- end -->", PAGE, re.DOTALL)
    assert found, f"docs/architecture.md has no diagram '{name}'"
    return found.group(1)


def test_the_layers_are_those_of_the_imports(draw: ModuleType) -> None:
    assert draw.mermaid(draw.layers()) in diagram("layers"), "run docs/draw_architecture.py"


@pytest.mark.parametrize("name", ["tick", "slip", "report"])
def test_a_path_leads_through_modules_that_exist(name: str) -> None:
    inside = [
        (folder, module)
        for folder, body in re.findall(
            r'subgraph \w+ \["(.+?)"\]\n(.*?)\n  end', diagram(name), re.S
        )
        for module in re.findall(r'\["(\w+)"\]', body)
    ]
    assert len(inside) > 10
    for folder, module in inside:
        assert (ROOT / "tactile_hand_ros" / folder / f"{module}.py").is_file(), (folder, module)


def test_a_folder_of_the_table_exists() -> None:
    named = re.findall(r"^\| `([\w/]+)/` \|", PAGE, re.MULTILINE)
    assert len(named) > 6
    for folder in named:
        assert (ROOT / "tactile_hand_ros" / folder).is_dir(), folder
