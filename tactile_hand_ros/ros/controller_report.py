# SPDX-License-Identifier: Apache-2.0
"""What the manipulation controller says of itself in its diagnostics."""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.controller import Command, Mode
from tactile_hand_ros.core.grasp import collinearity_margin
from tactile_hand_ros.core.manipulation import Target
from tactile_hand_ros.ros import interfaces
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.node import TactileNode


class ControllerReport:
    """Keeps faults and values up to date; costs next to nothing while all is well."""

    def __init__(self, node: TactileNode[Any]) -> None:
        """Report with the diagnostics of a node."""
        self._node = node
        self._last: Command | None = None
        self._contacts: Contacts | None = None

    def note(self, command: Command, contacts: Contacts | None = None) -> None:
        """Note an answer, and the contacts that it saw; none when they had not come."""
        last, self._last, self._contacts = self._last, command, contacts
        if last is not None and (command.mode, command.reason) == (last.mode, last.reason):
            return
        diagnostics = self._node.diagnostics
        if command.mode is Mode.HOLD:
            if contacts is not None:  # that inputs are missing is reported already
                diagnostics.fault("hold", command.reason)
        elif command.mode in (Mode.DISABLED, Mode.OPEN):
            diagnostics.fault("hold", command.reason, WARN)
        else:
            diagnostics.clear("hold")
            if command.reason:  # a pose for later whose time has come
                self._node.reject(interfaces.DESIRED_POSE, command.reason)

    def report(self, target: Target | None) -> None:
        """Put mode, distance to the target and the margin of A7 into the diagnostics."""
        put, last = self._node.diagnostics.value, self._last
        if last is not None:
            put("mode", last.mode.value)
        if last is not None and last.pose is not None and target is not None:
            error = float(np.linalg.norm(target.position - last.pose.position))
            put("position_error_m", error)
        if self._contacts is not None:
            put("collinearity_margin", collinearity_margin(self._contacts.positions))
