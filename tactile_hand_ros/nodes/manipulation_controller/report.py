# SPDX-License-Identifier: Apache-2.0
"""What the manipulation controller says of itself in its diagnostics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Command, Mode
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.margins import UNKNOWN_MARGINS, GraspMonitor
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.mode_log import ModeLog
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.node import TactileNode

Array = NDArray[np.float64]


class ControllerReport:
    """Keeps faults and values up to date; costs next to nothing while all is well."""

    def __init__(self, node: TactileNode[Any], hand: Hand) -> None:
        """Report with the diagnostics of a node on the grasp of a hand."""
        self._node = node
        self._watch = GraspMonitor(hand)
        self._modes = ModeLog(node.get_logger().info)
        self._theta: Array | None = None
        self._last: Command | None = None
        self._contacts: Contacts | None = None

    def reset(self) -> None:
        """Begin with a new grasp."""
        self._watch.reset()

    def note(
        self, command: Command, theta: Array | None = None, contacts: Contacts | None = None
    ) -> None:
        """Note an answer, and the joints and contacts that it saw; none when they had not come."""
        last, self._last, self._contacts = self._last, command, contacts
        self._theta = theta
        if last is not None and (command.mode, command.reason) == (last.mode, last.reason):
            return
        self._modes.note(command.mode.value, command.reason)
        diagnostics = self._node.diagnostics
        if command.mode is Mode.HOLD:
            if contacts is not None:  # that inputs are missing is reported already
                diagnostics.fault("hold", command.reason)
        elif command.mode in (Mode.DISABLED, Mode.OPEN):
            diagnostics.fault("hold", command.reason, WARN)
        else:
            diagnostics.clear("hold")
            if command.reason:  # a pose for later whose time has come
                self._node.reject(names.DESIRED_POSE, command.reason)

    def report(self, target: Target | None) -> None:
        """Put mode, distance to the target and the margins of the grasp into the diagnostics."""
        put, last = self._node.diagnostics.value, self._last
        if last is not None:
            put("mode", last.mode.value)
        if last is not None and last.pose is not None and target is not None:
            error = float(np.linalg.norm(target.position - last.pose.position))
            put("position_error_m", error)
        if self._contacts is None or self._theta is None:
            if last is None:
                return
            margins = UNKNOWN_MARGINS
        else:
            margins = self._watch.margins(self._theta, self._contacts)
        put("A1 face_travel_m", margins.face_travel)
        put("A2 hemisphere_margin_rad", margins.hemisphere)
        put("A5 joint_singularity_margin_m_per_rad", margins.joint)
        put("A7 collinearity_margin", margins.collinearity)
