# SPDX-License-Identifier: Apache-2.0
"""The force optimizer: how the fingers share the squeeze, (13).

Safe state: where (13) has no answer (a contact is missing, the contacts lie on a line, the normals
cannot balance) it publishes NaN, never an old answer, and says why; the controller then holds the
hand. With `cones` it answers only ticks at which the forces of all fingers and the state of their
grip have come too; where no f* lies inside the learned friction cones it publishes the one that
leaves them least, and warns. Input that cannot be used is counted and dropped. When it is silent or
dies, the controller holds the hand after its `input_timeout`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from std_msgs.msg import Bool

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.contact import Contacts, example_touch
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
)
from tactile_hand_ros.nodes.accepted import Accepted
from tactile_hand_ros.nodes.force_optimizer.report import OptimizerReport
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages.wire import WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.ticks import streams
from tactile_hand_ros.ros.ticks.inputs import TickInputs

Array = NDArray[np.float64]


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
    iterations and time of the solver, and with `cones` the margin that certifies f* (the least
    mu f_n - |f_t| per unit of squeeze) and whether the cones have shaped it.

    Parameters: the fields of `ForceOptimizerConfig`; weights, `minimum_normal` and `cone_share` are
    live. When the stamps jump back, the solver forgets its last answer and the load.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Set up the problem.

        Raises:
            TactileHandError: If a parameter is refused or there is no such hand.
        """
        super().__init__("force_optimizer", ForceOptimizerConfig, **kwargs)
        fingers = load_hand_config(self.config.hand).finger_names
        self._fingers = len(fingers)
        self._optimizer = ForceOptimizer(self.config, self._fingers)
        self._report = OptimizerReport(self.diagnostics)
        shapes, self._is_doubted = self.config.cones, False
        self._accepted = Accepted(self, names.OPTIMIZER, requests=shapes)
        self._sent: list[bytes] = []
        self._codecs = [
            WrenchCodec(names.contact_frame(name), nan_allowed=True) for name in fingers
        ]
        self._force_publishers = [
            self.tick_publisher(WrenchStamped, names.optimal_force(name)) for name in fingers
        ]
        self._rehearse(shapes)
        if shapes:
            latched = qos.latched_qos(qos.user_qos().depth)
            self.subscribe(Bool, names.TOUCH_REJECTED, self._on_doubt, profile=latched)
        declared = (
            streams.contacts(self._fingers),
            streams.learned_friction(fingers, wanted=shapes),
            streams.forces(fingers, wanted=shapes),
        )
        self._inputs = TickInputs(self, declared, self)

    def _rehearse(self, shapes: bool) -> None:
        contacts, forces = example_touch(self._fingers)
        touch = (np.ones(self._fingers), forces) if shapes else (None, None)
        self._optimizer.step(0, contacts, *touch)
        self.on_restart()

    def check_config(self, config: ForceOptimizerConfig) -> None:
        """Refuse weights and a least share that do not fit the hand."""
        config.weight_vector(self._fingers)
        config.check_minimum(self._fingers)

    def on_config(self, config: ForceOptimizerConfig) -> None:
        """Take other weights or another least share."""
        self._optimizer.configure(config)
        self._accepted.configuration(config)

    def on_report(self) -> None:
        """Report how the last tick was solved."""
        self._report.report()

    def on_restart(self) -> None:
        """Start over with the ticks."""
        self._optimizer.reset()
        self._accepted.begin(self.config)
        if self._is_doubted:
            self._accepted.request(names.TOUCH_REJECTED, True)

    def _on_doubt(self, message: Bool) -> None:
        if message.data != self._is_doubted:
            self._is_doubted = message.data
            self._optimizer.reject_touch(message.data)
            self._accepted.request(names.TOUCH_REJECTED, message.data)

    def on_tick(
        self, stamp: int, contacts: Contacts, friction: Array | None, forces: Array | None
    ) -> None:
        """Answer a tick for which everything has arrived."""
        began = time.perf_counter()
        optimal = self._optimizer.step(stamp, contacts, friction, forces)
        pairs = zip(self._codecs, optimal.forces.tolist(), strict=True)
        self._sent = [codec.encode(force, stamp) for codec, force in pairs]
        self.on_repeat()
        self._accepted.take_effect(stamp)
        self._report.note(optimal)
        self.diagnostics.tick()
        self.diagnostics.latency(time.perf_counter() - began)

    def on_repeat(self) -> None:
        """Give the last answer, which may be a new one."""
        for publisher, message in zip(self._force_publishers, self._sent, strict=True):
            publisher.publish(message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the force optimizer until SIGINT or SIGTERM and return the exit code."""
    return run_node(ForceOptimizerNode, args)


if __name__ == "__main__":
    sys.exit(main())
