# SPDX-License-Identifier: Apache-2.0
"""docs/reference/parameters.md lists the parameters declared in the code."""

import enum
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest

from tactile_hand_ros.cockpit.config import CockpitConfig
from tactile_hand_ros.config.model import leaves
from tactile_hand_ros.nodes.driver_output import DriverOutputConfig
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.scenario.scenario import NODES, Scenario, TargetConfig

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "parameters.md"
SHARED = ("hand", "layout", "gravity", "calibration", "seed", "duration")
MODELS = {name: Scenario.model_fields[name].annotation for name in NODES}
MODELS["recorder"] = RecorderConfig
MODELS["driver_output"] = DriverOutputConfig
MODELS["cockpit"] = CockpitConfig
SIGNS = {"Ge": "≥", "Gt": ">", "Le": "≤", "Lt": "<"}


def shown(value):
    """Return a default in the format of the page."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(shown(each) for each in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    value = value.value if isinstance(value, enum.Enum) else value
    return f"{value:g}" if isinstance(value, float) else str(value)


def row(name, field):
    default = "required" if field.is_required() else f"`{shown(field.default)}`"
    limits = [f"{SIGNS[kind]} {shown(getattr(each, kind.lower()))}" for each in field.metadata
              if (kind := type(each).__name__) in SIGNS]  # fmt: skip
    kind = field.annotation
    kind = get_args(kind)[0] if get_origin(kind) is list else kind
    if get_origin(kind) is Literal:
        limits = list(get_args(kind))
    extra = field.json_schema_extra
    cells = (f"`{name}`", "empty" if default == "``" else default, extra["unit"], ", ".join(limits),
             "yes" if extra["live"] else "", field.description.replace("|", "\\|"))  # fmt: skip
    return f"| {' | '.join(cells)} |"


@pytest.mark.parametrize("node", MODELS)
def test_the_page_lists_what_is_declared(node):
    text = PAGE.read_text("utf-8")
    section = text.split(f"\n## `{node}`\n")[1].split("\n## ")[0].split("\n### ")[0]
    written = [line for line in section.splitlines() if line.startswith("| `")]
    shared = {"recorder": (), "cockpit": ("hand", "object")}.get(node, SHARED)
    fields = {n: f for n, f in leaves(MODELS[node]).items() if n.split(".")[0] not in shared}
    assert written == [row(name, field) for name, field in fields.items()]


def test_the_page_lists_the_keys_of_a_target():
    section = PAGE.read_text("utf-8").split("\n### `targets`")[1].split("\n### ")[0]
    written = [line.split(" | ") for line in section.splitlines() if line.startswith("| `")]
    declared = [row(*each).split(" | ") for each in TargetConfig.model_fields.items()]
    # Lists of a scenario have no column for parameters that may change during a run.
    assert written == [[*cells[:4], cells[5]] for cells in declared]
