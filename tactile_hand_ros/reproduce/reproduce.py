# SPDX-License-Identifier: Apache-2.0
"""The paper's results from scratch: runs, figures and a table of claims against measurements."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactile_hand_ros.report.figures import friction_figure, law_figure, motion_figure
from tactile_hand_ros.report.scene import grasp_figure
from tactile_hand_ros.report.style import pretty, save
from tactile_hand_ros.report.tables import markdown
from tactile_hand_ros.reproduce import tables
from tactile_hand_ros.reproduce.claims import Claim, LawResult, compare_laws, judge
from tactile_hand_ros.reproduce.experiments import (
    EXPERIMENTS,
    ExperimentResult,
    run_experiment,
    scenario_of,
)
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.sweep.engine import in_parallel

Outcomes = Mapping[str, ExperimentResult]

REPORT = "reproduction.md"
DATA = "reproduction.json"


@dataclass(frozen=True)
class Reproduction:
    """What came out for one layout.

    Attributes:
        layout: Layout of the hand's fingers.
        outcomes: All experiments by key.
        claims: What the paper claims and what was measured.
        laws: What the laws (8), (10) and (14) do on the same task.
    """

    layout: str
    outcomes: Outcomes
    claims: list[Claim]
    laws: list[LawResult]


def reproduce(
    layouts: Sequence[str],
    duration: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Reproduction]:
    """Run all experiments, where `workers` says, and judge the paper's claims.

    Args:
        layouts: Layouts of the hand's fingers.
        duration: Simulated time in s instead of the scenarios'.
        progress: Called with a sentence whenever an experiment is done.

    Raises:
        ConfigurationError: If a layout or duration cannot be used.
    """
    for layout in layouts:  # before any process starts
        check_scenario(scenario_of("optimal", layout, duration))
    found: dict[str, dict[str, ExperimentResult]] = {layout: {} for layout in layouts}
    tasks = [(key, layout, duration) for layout in layouts for key in EXPERIMENTS]
    for outcome in in_parallel(_run, tasks, ordered=False):
        found[outcome.layout][outcome.key] = outcome
        progress(f"{pretty(outcome.layout)}: {EXPERIMENTS[outcome.key].meaning}")
    return [_judged(layout, outcomes) for layout, outcomes in found.items()]


def _run(task: tuple[str, str, float | None]) -> ExperimentResult:
    return run_experiment(*task)


def _judged(layout: str, outcomes: Outcomes) -> Reproduction:
    return Reproduction(layout, outcomes, judge(outcomes), compare_laws(outcomes))


def draw(
    result: Reproduction, folder: Path, formats: tuple[str, ...] = ("png", "svg")
) -> list[Path]:
    """Draw Fig. 2, 3 and 4 and the comparison of the laws; return the files.

    Args:
        result: One layout.
        folder: Where to.
        formats: Suffixes of the files.
    """
    runs = {key: outcome.record for key, outcome in result.outcomes.items()}
    optimal = result.outcomes["optimal"]
    figures = {
        "fig2": grasp_figure(optimal.record, optimal.scenario),
        "fig3": motion_figure(optimal.record),
        "fig4": friction_figure(
            {"tangential forces penalised": runs["optimal"], "nominal, W = I": runs["nominal"]}
        ),
        "laws": law_figure(
            {"(8)": runs["kawamura"], "(10)": runs["contact"], "(14)": runs["optimal"]}
        ),
    }
    return [
        file
        for name, figure in figures.items()
        for file in save(figure, folder, f"{name}_{result.layout}", formats)
    ]


def write(results: Sequence[Reproduction], folder: Path, picture: str = "png") -> list[Path]:
    """Write the report as Markdown and all numbers as JSON; return the files.

    Args:
        results: All layouts.
        folder: Where to, next to the figures.
        picture: Suffix of the figures that the report shows.
    """
    folder.mkdir(parents=True, exist_ok=True)
    report, data = folder / REPORT, folder / DATA
    report.write_text(
        "\n".join([_HEAD, *(_section(r, picture) for r in results)]), encoding="utf-8"
    )
    content = {result.layout: json_ready(_plain(result)) for result in results}
    data.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return [report, data]


_HEAD = """# The paper's results, reproduced

Object manipulation with tactile sensing for prosthetic hands (Shaw-Cortez, Oetomo, Manzie, Choong),
Table I, in-process (`tactile-hand reproduce`). The paper does not print where the fingers
stand: `three_faces` and `pinch` are two readings of it.
"""

_LAWS = """What the laws do on the same task. Under (8) and (10) k_f multiplies lengths, so that
the same number is another force than under (14). Rolling is how far a contact moved over the
object, stiffness how hard the contacts are pulled per metre of position error.
"""

_FIGURES = {
    "fig2": "Fig. 2: hand and object at the start and at the end",
    "fig3": "Fig. 3: joint rates, position, orientation error, normal forces",
    "fig4": "Fig. 4: the friction coefficient that each contact needs, under both weightings",
    "laws": "The laws (8), (10) and (14) on the same task; a cross marks a lost contact",
}


def _section(result: Reproduction, picture: str) -> str:
    pictures = [f"![{text}]({name}_{result.layout}.{picture})\n" for name, text in _FIGURES.items()]
    claims = markdown(tables.CLAIM_COLUMNS, tables.claim_rows(result.claims))
    laws = markdown(tables.LAW_COLUMNS, tables.law_rows(result.laws))
    return "\n".join(
        [
            f"## Layout {result.layout}\n",
            claims,
            _LAWS,
            laws,
            *pictures,
        ]
    )


def _plain(result: Reproduction) -> dict[str, Any]:
    return {
        "claims": [{**asdict(claim), "verdict": claim.verdict.value} for claim in result.claims],
        "laws": [asdict(law) for law in result.laws],
        "metrics": {key: outcome.metrics.to_dict() for key, outcome in result.outcomes.items()},
    }
