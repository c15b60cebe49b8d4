# SPDX-License-Identifier: Apache-2.0
"""From joint torques to what a driver takes: positions, velocities, currents or efforts.

The torque tau is clipped to the effort limits first. Then

    position:  q_cmd = q + tau / k    for a servo that applies k (q_cmd - q),
    velocity:  v_cmd = tau / d        for a servo that applies d (v_cmd - q'),
    current:   i_cmd = tau / k_t      for a motor that applies k_t i.

At rest each applies tau. In motion, a position servo lacks k times the travel since q was measured:
an age T of q acts as a damping k T. A velocity servo adds the damping d. If it also integrates its
error, it presses on an object with its full torque: such a servo is not suitable.
"""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import Coupling, DriverConfig
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.hand.hand import Hand

_GAINS = {"position": "stiffness", "velocity": "damping", "current": "torque_constant"}


class DriverOutput:
    """Computes the output for the n joints of a driver from the torques of the m driven joints.

    Attributes:
        joints: The driver's names of its joints, in its order.
        clipped: Number of outputs that a limit of effort, angle or speed has changed.
    """

    def __init__(self, config: DriverConfig, hand: Hand) -> None:
        """Choose the law.

        Raises:
            ConfigurationError: If a gain is missing, or the joints are not those of the hand.
        """
        names = config.names or {name: name for name in hand.joint_names}
        self.joints, self.clipped = list(names.values()), 0
        self._output, self._hand, self._last = config.output, hand, np.zeros(0)
        self._gains = _gains(config, hand.joint_names)
        self._selection, self._offsets = _selection(config, list(names), hand)

    def step(self, theta: Array, torque: Array) -> Array:
        """Return the output, (n,), in the driver's units, of angles and finite torques, (m,)."""
        limit, start = self._hand.effort_limits, np.zeros_like(theta)
        high = self._hand.velocity_limits if self._output == "velocity" else start + np.inf
        low = -high
        if self._output == "position":
            # From outside the range, a goal at its end would be a torque that was not commanded.
            lower, upper = self._hand.position_limits
            low, high, start = np.minimum(lower, theta), np.maximum(upper, theta), theta
        wanted = start + np.clip(torque, -limit, limit) / self._gains
        possible = np.clip(wanted, low, high)
        self.clipped += bool((np.abs(torque) > limit).any() or (possible != wanted).any())
        self._last = self._selection @ possible + self._offsets
        return self._last

    def rest(self) -> Array:
        """Return the output without commands: the last position, or 0; empty before the first."""
        return self._last if self._output == "position" else 0.0 * self._last


def _gains(config: DriverConfig, joints: list[str]) -> Array:
    """Return the gain of each joint, shape (m,)."""
    key = _GAINS.get(config.output, "")
    given: dict[str, float] = getattr(config, key, {"*": 1.0})
    if set(given) not in ({"*"}, set(joints)):
        raise ConfigurationError(
            f"driver.{key} has values for {', '.join(given) or 'no joint'}, but the output "
            f"'{config.output}' needs one number, or one for each of {', '.join(joints)}."
        )
    return np.array([given.get(name, given.get("*")) for name in joints])


def _selection(config: DriverConfig, names: list[str], hand: Hand) -> tuple[Array, Array]:
    """Return S, shape (n, m), and the offsets, shape (n,), of the driver's joints S x + offset."""
    driven, is_motion = hand.joint_names, config.output in ("position", "velocity")
    selection, offsets = np.zeros((len(names), len(driven))), np.zeros(len(names))
    for name in (*names, *driven):
        if name not in names or name not in {*driven, *hand.couplings, *config.fixed}:
            raise ConfigurationError(
                f"driver.names {'has' if name in names else 'lacks'} '{name}', expected each of "
                f"{', '.join(driven)}, and otherwise joints that follow or are in driver.fixed."
            )
        row, rest = names.index(name), config.fixed.get(name, 0.0)
        own = hand.couplings.get(name) or Coupling(joint=name, offset=rest)
        if own.joint in driven and (is_motion or name in driven):  # others share its torque
            selection[row, driven.index(own.joint)] = own.ratio
        offsets[row] = own.offset if config.output == "position" else 0.0
    unit = np.degrees(1.0) if config.degrees and is_motion else 1.0
    return unit * selection, unit * offsets
