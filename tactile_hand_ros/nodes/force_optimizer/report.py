# SPDX-License-Identifier: Apache-2.0
"""What the force optimizer says of its answers in its diagnostics."""

from __future__ import annotations

from tactile_hand_ros.control.optimizer.force_optimizer import OptimalForces
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly

_OUTSIDE = -1e-5
"""Cone margin below which f* is outside, and not on the edge by the solver's accuracy."""

_SLIPS = (
    "f* under the load is outside the friction cones learned so far (margin {:.3g} per unit of "
    "squeeze): a contact may slip; raise the squeeze or take load off"
)


class OptimizerReport:
    """Counts ticks without an answer and notices when an answer lies outside the friction cones.

    The optimization keeps a reserve to the cones. That the reserve is used up is no reason to warn.
    """

    def __init__(self, diagnostics: Diagnostics) -> None:
        """Report with the diagnostics of a node."""
        self._diagnostics = diagnostics
        self._optimal: OptimalForces | None = None
        self._reason = ""
        self._unanswered = 0
        self._outside, self._worst = Mostly(), 0.0

    def note(self, optimal: OptimalForces) -> None:
        """Note the answer of a tick."""
        self._optimal = optimal
        # Only where the margin of load does not hold; NaN: without cones.
        margin = optimal.learned_margin if optimal.cone_margin < _OUTSIDE else 0.0
        self._outside.note(margin < _OUTSIDE)
        self._worst = min(self._worst, margin)
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
        self._diagnostics.judge("cones", self._outside(), _SLIPS.format(self._worst), WARN)
        self._worst = 0.0
