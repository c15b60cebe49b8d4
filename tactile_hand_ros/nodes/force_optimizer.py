# SPDX-License-Identifier: Apache-2.0
"""The force optimizer: distribution of the grasp force over the fingers, (13).

Safe state: if (13) has no solution (a contact is missing, the contacts lie on a line, the normals
cannot balance), it publishes NaN with the reason, never an old solution, and the controller holds
the hand. With `cones` it answers only ticks that include the regulator's estimates. If no f* lies
inside the learned friction cones, it publishes the one closest to them and warns. Invalid input is
counted and dropped. If the optimizer is silent or crashes, the controller holds the hand after its
`input_timeout`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    OptimalForces,
)
from tactile_hand_ros.nodes.user_changes import AppliedChanges
from tactile_hand_ros.ros import streams
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly
from tactile_hand_ros.ros.messages import WrenchPublishers
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import TickInputs

_OUTSIDE = -1e-5
"""Cone margin below which f* is outside, beyond the solver's accuracy."""

_SLIPS = (
    "f* under the load is outside the usable friction cones (margin {:.3g} per unit of "
    "grasp force): a contact may slip; raise the grasp force or reduce the load"
)


class OptimizerReport:
    """Counts ticks without a solution and detects solutions outside the friction cones.

    The optimization keeps a reserve to the cones. A used-up reserve is no reason to warn.
    """

    def __init__(self, diagnostics: Diagnostics) -> None:
        """Report with the diagnostics of a node."""
        self._diagnostics = diagnostics
        self._optimal: OptimalForces | None = None
        self._unanswered = 0
        self._outside, self._worst = Mostly(), 0.0

    def note(self, optimal: OptimalForces) -> None:
        """Record the solution of a tick."""
        self._optimal = optimal
        margin = optimal.cone_margin  # NaN: without cones
        self._outside.note(margin < _OUTSIDE)
        self._worst = min(self._worst, margin)  # min keeps the first if the second is NaN
        self._unanswered += not optimal.ok
        self._diagnostics.judge("optimization", not optimal.ok, optimal.reason)

    def report(self) -> None:
        """Add the last solution to the diagnostics."""
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


class ForceOptimizerNode(TactileNode[ForceOptimizerConfig]):
    """Publishes the optimal normalized forces f* of each tick.

    Subscriptions: `tactile/contacts` (geometry_msgs/PoseArray, palm frame, m). Only with `cones`,
    with the same timestamp: `load/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`, N),
    `grip_margin` (sensor_msgs/JointState by finger: usable friction, reserve in N) and
    `grasp_force` (geometry_msgs/WrenchStamped, k_f in force.y, N).

    Publications: `optimal_force/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`,
    dimensionless, normal components sum to 1; NaN without a solution; timestamp of the input).
    `accepted/force_optimizer/parameters` (rcl_interfaces/ParameterEvent: the configuration in
    force, stamped with its first tick). Once a second: `/diagnostics` with status, residual,
    iterations and time of the solver, and with `cones` the margin that certifies f* (the minimum
    mu f_n - |f_t| per unit of grasp force) and whether the cones shaped it.

    Parameters: the fields of `ForceOptimizerConfig`; weights, `minimum_normal` and times are live.
    When the timestamps jump back, the solver discards its last solution and the load.
    """

    def __init__(self, *, composed: bool = False, **kwargs: Any) -> None:
        """Set up the problem; with `composed` a chain calls `step` and no ticks are received."""
        super().__init__("force_optimizer", ForceOptimizerConfig, **kwargs)
        fingers = load_hand_config(self.config.hand).finger_names
        self._fingers = len(fingers)
        self._optimizer = ForceOptimizer(self.config, self._fingers)
        self._report = OptimizerReport(self.diagnostics)
        self._changes = AppliedChanges(self, names.OPTIMIZER)
        self._publisher = WrenchPublishers(self, fingers, names.optimal_force, nan_allowed=True)
        self._rehearse()
        if composed:
            return
        declared = [streams.contacts(self._fingers)]
        if self.config.cones:
            declared += [streams.loads(fingers), streams.grip_margin(fingers)]
            declared.append(streams.grasp_force())
        self._inputs = TickInputs(self, declared, self)

    def _rehearse(self) -> None:
        contacts, forces = example_touch(self._fingers)
        ones = np.ones(self._fingers)
        for stamp in (0, 1):  # the second follows the first
            self._optimizer.step(stamp, contacts, CarriedLoad(forces, ones, ones), 1.0)
        self.on_restart()

    def check_config(self, config: ForceOptimizerConfig) -> None:
        """Reject weights and a minimum fraction that do not fit the hand."""
        config.weight_vector(self._fingers)

    def on_config(self, config: ForceOptimizerConfig) -> None:
        """Apply changed weights, minimum fraction or times."""
        self._optimizer.configure(config)
        self._changes.configuration(config)

    def on_report(self) -> None:
        """Report how the last tick was solved."""
        self._report.report()

    def on_restart(self) -> None:
        """Reset when the ticks start over."""
        self._optimizer.reset()
        self._changes.begin(self.config)

    def step(
        self,
        stamp: int,
        contacts: Contacts,
        carried: CarriedLoad | None = None,
        grasp_force: float = np.nan,
    ) -> OptimalForces:
        """Publish and return f*; see `ForceOptimizer.step`."""
        with self.answering():
            optimal = self._optimizer.step(stamp, contacts, carried, grasp_force)
            self._publisher.publish(stamp, optimal.forces)
            self._changes.take_effect(stamp)
            self._report.note(optimal)
        return optimal

    def on_tick(self, stamp: int, contacts: Contacts, *estimates: Any) -> None:
        """Answer a complete tick."""
        if estimates:
            load, margins, grasp_force = estimates
            self.step(stamp, contacts, CarriedLoad(load, *margins), grasp_force)
        else:
            self.step(stamp, contacts)
