# SPDX-License-Identifier: Apache-2.0
"""What the slip regulator says of itself in its diagnostics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.margins import SlipMonitor
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics, Mostly


class GripState(NamedTuple):
    """What the regulator knows of each contact, arrays of shape (k,)."""

    friction: NDArray[np.float64]
    evidence: NDArray[np.float64]
    grip: NDArray[np.int_]


class RegulatorReport:
    """Counts slips and notices when squeezing is at its end.

    What the object needs is a matter of the modes `shared` and `auto`; in `user` the user decides.
    """

    def __init__(self, diagnostics: Diagnostics, fingers: Sequence[str]) -> None:
        """Report on the fingers of these names."""
        self._diagnostics = diagnostics
        self._fingers = tuple(fingers)
        self.reset()

    def reset(self) -> None:
        """Start counting at zero."""
        self._grip: NDArray[np.int_] = np.zeros(len(self._fingers), dtype=int)
        self._slips: NDArray[np.int_] = np.zeros(len(self._fingers), dtype=int)
        self._limited, self._hopeless, self._most_needed = Mostly(), Mostly(), 0.0
        self._watch = SlipMonitor()

    def note(
        self,
        regulator: SlipRegulator,
        stamp: int,
        contacts: Contacts,
        forces: NDArray[np.float64],
        state: GripState,
    ) -> None:
        """Note a tick: what was felt, in contact frames, and what the regulator made of it."""
        grip = state.grip
        self._watch.note(stamp, contacts, forces, state.friction, grip, state.evidence)
        before, self._grip = self._grip, grip
        self._slips += (grip == ContactState.SLIP) & (before != ContactState.SLIP)
        reflex_is_on = regulator.config.mode != "user"
        # At the limit because of a slip that is over, nothing is missing.
        self._limited.note(reflex_is_on and regulator.config.maximum < regulator.needed < math.inf)
        self._hopeless.note(reflex_is_on and math.isinf(regulator.needed))
        if math.isfinite(regulator.needed):
            self._most_needed = max(self._most_needed, regulator.needed)

    def report(self, regulator: SlipRegulator) -> None:
        """Put mode, squeezes and the grip of each finger into the diagnostics."""
        put = self._diagnostics.value
        put("mode", regulator.config.mode)
        put("grasp_force_n", regulator.grasp_force)
        put("needed_force_n", regulator.needed)
        put("slips", int(self._slips.sum()))
        facts = zip(
            self._fingers,
            regulator.learned_friction,
            self._grip,
            regulator.slip_likelihood,
            self._slips,
            strict=True,
        )
        for name, friction, grip, evidence, slips in facts:
            put(f"friction {name}", float(friction))
            put(f"grip {name}", ContactState(int(grip)).name.lower())
            put(f"slip_evidence {name}", float(evidence))
            put(f"slips {name}", int(slips))
        watch = self._watch
        put("A3 load_n", watch.load)
        put("A4 slip_margin", watch.evidence)
        put("A4 cone_margin_n", watch.cone)
        put("A6 slip_time_left_s", watch.time_left)
        watch.clear()
        self._warn(regulator)

    def _warn(self, regulator: SlipRegulator) -> None:
        needed, maximum = self._most_needed, regulator.config.maximum
        self._most_needed = 0.0
        self._diagnostics.judge(
            "limit",
            self._limited(),
            f"the object needs a squeeze of {needed:.3g} N, but the limit is {maximum:g} N; raise "
            "'maximum' if the object can bear it, or take load off",
            WARN,
        )
        self._diagnostics.judge(
            "shape",
            self._hopeless(),
            "no squeeze of this shape can hold: a contact leaves its friction cone however large "
            "k_f is; let the force_optimizer reshape it ('cones') or take load off",
            WARN,
        )
