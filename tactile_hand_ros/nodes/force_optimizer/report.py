# SPDX-License-Identifier: Apache-2.0
"""What the force optimizer says of its answers in its diagnostics."""

from __future__ import annotations

from tactile_hand_ros.control.optimizer.force_optimizer import OptimalForces
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly

_OUTSIDE = -1e-5
"""Cone margin below which f* is outside, and not on the edge by the solver's accuracy."""


class OptimizerReport:
    """Counts ticks without an answer and notices when no answer lies inside the cones."""

    def __init__(self, diagnostics: Diagnostics) -> None:
        """Report with the diagnostics of a node."""
        self._diagnostics = diagnostics
        self._optimal: OptimalForces | None = None
        self._reason = ""
        self._unanswered = 0
        self._uncertified = Mostly()

    def note(self, optimal: OptimalForces) -> None:
        """Note the answer of a tick."""
        self._optimal = optimal
        self._uncertified.note(optimal.cone_margin < _OUTSIDE)  # NaN: not looked at
        self._unanswered += not optimal.ok
        if optimal.reason == self._reason:
            return
        self._reason = optimal.reason
        if optimal.ok:
            self._diagnostics.clear("optimization")
        else:
            self._diagnostics.fault("optimization", optimal.reason)

    def report(self) -> None:
        """Put how the last tick was solved into the diagnostics."""
        put, optimal = self._diagnostics.value, self._optimal
        put("unanswered_ticks", self._unanswered)
        if optimal is None:
            return
        put("status", optimal.status.value)
        put("residual", optimal.residual)
        put("solve_time_us", 1e6 * optimal.solve_time)
        put("iterations", optimal.iterations)
        put("cone_margin", optimal.cone_margin)
        put("shaped", optimal.shaped)
        self._diagnostics.judge(
            "cones",
            self._uncertified(),
            f"no f* lies inside the estimated friction cones (margin {optimal.cone_margin:.3g} "
            "per unit of squeeze); a contact will slip unless the squeeze rises or load goes",
            WARN,
        )
