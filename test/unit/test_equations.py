# SPDX-License-Identifier: Apache-2.0
"""docs/reference/equations.md names existing code that names its equation."""

import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tactile_hand_ros"
PAGE = ROOT / "docs" / "reference" / "equations.md"


def table(heading: str) -> list[list[str]]:
    """Return the cells of the table whose first column has a heading."""
    lines = PAGE.read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| {heading} |"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


EQUATIONS = table("equation")


def resolve(name: str) -> Any:
    """Return the object of a dotted name below the package, or next to it."""
    is_next_to_it = name.startswith(("bench.", "studies."))
    return pkgutil.resolve_name(name if is_next_to_it else f"{PACKAGE}.{name}")


def test_every_equation_has_a_home():
    named = {row[0] for row in EQUATIONS}
    assert {f"({number})" for number in range(1, 16)} | {"R_pov", "r_d", "beta"} <= named


@pytest.mark.parametrize("row", EQUATIONS, ids=lambda row: f"{row[0]} {row[2]}")
def test_the_named_code_exists_and_names_its_equation(row):
    equation, _, name = row
    assert equation in resolve(name.strip("`")).__doc__


def test_no_other_code_writes_the_grasp_map_or_the_hand_jacobian_again():
    """They would contain skew matrices or cross products of many vectors."""
    allowed = {f"{row[0].strip('`').replace('.', '/')}.py" for row in table("module")}
    allowed |= {"report/scene.py", "simulation/solid.py", "simulation/palm_motion.py"}  # mechanics
    allowed |= {"control/stability.py"}  # how forces turn with an object: their geometric stiffness
    allowed |= {"control/laws.py", "control/reach.py"}  # a wrench about another point; rolling
    found = {
        str(path.relative_to(ROOT / PACKAGE))
        for path in (ROOT / PACKAGE).rglob("*.py")
        if re.search(r"\bskew\(|np\.cross\(", path.read_text())
    }
    assert found <= allowed
