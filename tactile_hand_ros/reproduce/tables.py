# SPDX-License-Identifier: Apache-2.0
"""The paper's claims and the comparison of its laws as tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tactile_hand_ros.report.tables import number, plain, rich_table
from tactile_hand_ros.reproduce.claims import Claim, ClaimVerdict, LawResult

if TYPE_CHECKING:
    from rich.table import Table

CLAIM_COLUMNS = ("source", "the paper", "measured", "verdict")
LAW_COLUMNS = (
    "law",
    "position error",
    "|r_d|",
    "contact lost",
    "peak joint rate",
    "sum of f_n",
    "worst beta",
    "rolling",
    "stiffness",
)
_COLORS = {ClaimVerdict.HOLDS: "green", ClaimVerdict.PARTLY: "yellow", ClaimVerdict.FAILS: "red"}


def claim_rows(claims: Sequence[Claim]) -> list[list[str]]:
    """Return claims as text, columns as in `CLAIM_COLUMNS`."""
    return [[c.source, c.statement, c.measured, c.verdict.value] for c in claims]


def law_rows(laws: Sequence[LawResult]) -> list[list[str]]:
    """Return the comparison of laws as text, columns as in `LAW_COLUMNS`."""
    return [
        [
            law.law,
            number(1e3 * law.final_position_error_m, "mm"),
            number(law.final_rotation_error_rad, "rad"),
            "never"
            if math.isnan(law.first_contact_loss_s)
            else f"{law.first_contact_loss_s:.2f} s",
            number(law.peak_joint_rate_rad_per_s, "rad/s"),
            number(law.normal_force_sum_N, "N"),
            number(law.worst_required_friction),
            number(1e3 * law.largest_rolling_m, "mm"),
            number(law.stiffness_N_per_m, "N/m"),
        ]
        for law in laws
    ]


def claim_table(title: str, claims: Sequence[Claim]) -> Table:
    """Return claims as a table for the terminal."""
    table = rich_table(title, CLAIM_COLUMNS)
    for claim, row in zip(claims, claim_rows(claims), strict=True):
        color = _COLORS[claim.verdict]
        table.add_row(*map(plain, row[:-1]), f"[{color}]{row[-1]}[/{color}]", end_section=True)
    return table
