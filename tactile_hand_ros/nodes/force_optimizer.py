# SPDX-License-Identifier: Apache-2.0
"""The force optimizer: how the grasp force is distributed over the fingers, (13).

Safe state: where (13) has no answer (a contact is missing, the contacts lie on a line, the normals
cannot balance) it publishes NaN, never an old answer, and the reason; the controller then holds the
hand. With `cones` it answers only ticks at which the forces of all fingers and the state of their
grip have come too; where no f* lies inside the learned friction cones it publishes the one that
leaves them least, and warns. Input that cannot be used is counted and dropped. When it is silent or
crashes, the controller holds the hand after its `input_timeout`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Bool

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    OptimalForces,
)
from tactile_hand_ros.nodes.common import WrenchPublishers
from tactile_hand_ros.nodes.user_changes import AppliedChanges
from tactile_hand_ros.ros import qos, streams
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.ticks import TickInputs

Array = NDArray[np.float64]

_OUTSIDE = -1e-5
"""Cone margin below which f* is outside, and not on the edge by the solver's accuracy."""

_SLIPS = (
    "f* under the load is outside the friction cones learned so far (margin {:.3g} per unit of "
    "grasp force): a contact may slip; raise the grasp force or take load off"
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


class ForceOptimizerNode(TactileNode[ForceOptimizerConfig]):
    """Publishes the optimal normalised forces f* of each tick.

    Subscriptions: `tactile/contacts` (geometry_msgs/PoseArray, palm frame, m). With `cones` also,
    of the same stamp: `tactile/<finger>/wrench` (geometry_msgs/WrenchStamped in `<finger>_contact`,
    N) and `grip_state` (sensor_msgs/JointState by finger, of which the learned friction counts),
    and `touch_rejected` (std_msgs/Bool, whether the controller rejects the touch, from which
    nothing is learned then); without, they would only cost time.

    Publications: `optimal_force/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`,
    without unit, the normal components sum up to 1; NaN without an answer; stamp of the input).
    `accepted/force_optimizer/parameters` (rcl_interfaces/ParameterEvent: the configuration in
    force, stamped with its first tick). Once a second: `/diagnostics` with status, residual,
    iterations and time of the solver, and with `cones` the margin that certifies f* (the minimum
    mu f_n - |f_t| per unit of grasp force) and whether the cones have shaped it.

    Parameters: the fields of `ForceOptimizerConfig`; weights, `minimum_normal` and `cone_share` are
    live. When the stamps jump back, the solver forgets its last answer and the load.
    """

    def __init__(self, *, composed: bool = False, **kwargs: Any) -> None:
        """Set up the problem.

        Args:
            composed: Whether a chain in this process calls `step` and `reject_touch`, so that
                neither ticks nor `touch_rejected` are received.
            **kwargs: For `rclpy.node.Node`.

        Raises:
            TactileHandError: If a parameter is rejected or there is no such hand.
        """
        super().__init__("force_optimizer", ForceOptimizerConfig, **kwargs)
        fingers = load_hand_config(self.config.hand).finger_names
        self._fingers = len(fingers)
        self._optimizer = ForceOptimizer(self.config, self._fingers)
        self._report = OptimizerReport(self.diagnostics)
        self._shapes = self.config.cones
        self._changes = AppliedChanges(self, names.OPTIMIZER, requests=self._shapes)
        self._publisher = WrenchPublishers(self, fingers, names.optimal_force, nan_allowed=True)
        self._rehearse()
        if composed:
            return
        declared = [streams.contacts(self._fingers)]
        if self._shapes:
            latched = qos.latched_qos(qos.USER_DEPTH)
            self.subscribe(
                Bool, names.TOUCH_REJECTED, lambda m: self.reject_touch(m.data), profile=latched
            )
            declared += [streams.learned_friction(fingers), streams.forces(fingers)]
        self._inputs = TickInputs(self, declared, self)

    def _rehearse(self) -> None:
        contacts, forces = example_touch(self._fingers)
        self._optimizer.step(0, contacts, np.ones(self._fingers), forces)
        self.on_restart()

    def check_config(self, config: ForceOptimizerConfig) -> None:
        """Reject weights and a minimum fraction that do not fit the hand."""
        config.weight_vector(self._fingers)
        config.check_minimum(self._fingers)

    def on_config(self, config: ForceOptimizerConfig) -> None:
        """Take other weights or another minimum fraction."""
        self._optimizer.configure(config)
        self._changes.configuration(config)

    def on_report(self) -> None:
        """Report how the last tick was solved."""
        self._report.report()

    def on_restart(self) -> None:
        """Start over with the ticks."""
        self._optimizer.reset()
        self._changes.begin(self.config)

    def reject_touch(self, rejected: bool) -> None:
        """Note whether the controller rejects touch; the load is not learned from it then."""
        if self._shapes and self._changes.state(names.TOUCH_REJECTED, rejected):
            self._optimizer.reject_touch(rejected)

    def step(
        self,
        stamp: int,
        contacts: Contacts,
        friction: Array | None = None,
        forces: Array | None = None,
    ) -> OptimalForces:
        """Publish and return f*; see `ForceOptimizer.step`."""
        with self.answering():
            optimal = self._optimizer.step(stamp, contacts, friction, forces)
            self._publisher.publish(stamp, optimal.forces)
            self._changes.take_effect(stamp)
            self._report.note(optimal)
        return optimal

    on_tick = step


def main(args: Sequence[str] | None = None) -> int:
    """Run the force optimizer until SIGINT or SIGTERM and return the exit code."""
    return run_node(ForceOptimizerNode, args)
