# SPDX-License-Identifier: Apache-2.0
"""The force optimizer: how the fingers share the squeeze, (13).

Safe state: where (13) has no answer (a contact is missing, the contacts lie on a line, the normals
cannot balance) it publishes NaN, never an old answer, and says why; the controller then holds the
hand. Contacts that cannot be used are counted and dropped. When it is silent or dies, the
controller holds the hand after its `input_timeout`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseArray, WrenchStamped

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    OptimalForces,
)
from tactile_hand_ros.core.hand_config import load_hand_config
from tactile_hand_ros.ros import interfaces
from tactile_hand_ros.ros.matching import REPEAT, StampMatcher
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.wire import ContactsCodec, WrenchCodec


class ForceOptimizerNode(TactileNode[ForceOptimizerConfig]):
    """Publishes the optimal normalised forces f* of each tick.

    Subscription: `tactile/contacts` (geometry_msgs/PoseArray, palm frame, m).

    Publications: `optimal_force/<finger>` (geometry_msgs/WrenchStamped in `<finger>_contact`,
    without unit, the normal components sum up to 1; NaN without an answer; stamp of the input).
    Once a second: `/diagnostics` with status, residual, iterations and time of the solver.

    Parameters: the fields of `ForceOptimizerConfig`; all but `hand` are live. When the stamps jump
    back, the solver forgets its last answer.
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
        self._optimal: OptimalForces | None = None
        self._reason = ""
        self._unanswered = 0
        self._sent: list[bytes] = []
        self._codecs = [WrenchCodec(interfaces.contact_frame(name)) for name in fingers]
        self._publishers = [
            self.tick_publisher(WrenchStamped, interfaces.optimal_force(name)) for name in fingers
        ]
        self._contacts = ContactsCodec(self._fingers)
        self._matcher = StampMatcher((interfaces.CONTACTS,), on_restart=self._optimizer.reset)
        self.subscribe(PoseArray, interfaces.CONTACTS, self._on_contacts, raw=True)

    def check_config(self, config: ForceOptimizerConfig) -> None:
        """Refuse weights that do not fit the hand."""
        config.weight_vector(self._fingers)

    def on_config(self, config: ForceOptimizerConfig) -> None:
        """Take other weights or another least share."""
        self._optimizer.configure(config)

    def on_report(self) -> None:
        """Report how the last tick was solved."""
        put, optimal = self.diagnostics.value, self._optimal
        put("unanswered_ticks", self._unanswered)
        if optimal is not None:
            put("status", optimal.status.value)
            put("residual", optimal.residual)
            put("solve_time_us", 1e6 * optimal.solve_time)
            put("iterations", optimal.iterations)

    def _on_contacts(self, data: bytes) -> None:
        stamp, (positions, quaternions) = self._contacts.decode(data)
        matched = self._matcher.put(interfaces.CONTACTS, stamp, None)
        if matched is None:
            return
        if matched is REPEAT:
            self._publish()
            return
        began = time.perf_counter()
        optimal = self._optimizer.solve(Contacts.from_poses(positions, quaternions))
        pairs = zip(self._codecs, optimal.forces, strict=True)
        self._sent = [codec.encode(force, stamp) for codec, force in pairs]
        self._publish()
        self._judge(optimal)
        self.diagnostics.tick()
        self.diagnostics.latency(time.perf_counter() - began)

    def _publish(self) -> None:
        for publisher, message in zip(self._publishers, self._sent, strict=True):
            publisher.publish(message)

    def _judge(self, optimal: OptimalForces) -> None:
        self._optimal = optimal
        self._unanswered += not optimal.ok
        if optimal.reason == self._reason:
            return
        self._reason = optimal.reason
        if optimal.ok:
            self.diagnostics.clear("optimization")
        else:
            self.diagnostics.fault("optimization", optimal.reason)


def main(args: Sequence[str] | None = None) -> int:
    """Run the force optimizer until SIGINT or SIGTERM and return the exit code."""
    return run_node(ForceOptimizerNode, args)


if __name__ == "__main__":
    sys.exit(main())
