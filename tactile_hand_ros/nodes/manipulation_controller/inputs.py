# SPDX-License-Identifier: Apache-2.0
"""What the manipulation controller hears: all inputs of a tick together, or which are missing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.ros.messages.wire import ContactsCodec, JointCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks.backlog import Backlog
from tactile_hand_ros.ros.ticks.input_watch import InputWatch
from tactile_hand_ros.ros.ticks.matching import REPEAT, StampMatcher

Array = NDArray[np.float64]

DAY_NS = 86_400_000_000_000


def far_ahead(stamp: int, tick: int) -> str:
    """Return what is wrong with a stamp that is more than a day ahead of a tick [ns]."""
    return (
        f"the stamp is {1e-9 * (stamp - tick):.0f} s ahead of the ticks, which are at "
        f"{1e-9 * tick:.3f} s; use their time, or 0 for at once."
    )


class TickInputs(NamedTuple):
    """Everything of one tick, as the core takes it; see `Controller.step`."""

    stamp: int
    theta: Array
    rates: Array
    contacts: Contacts
    optimal_forces: Array
    grasp_force: float
    forces: Array | None


class TickListener(Protocol):
    """Who answers ticks."""

    def on_tick(self, inputs: TickInputs) -> None:
        """Answer a tick."""

    def on_repeat(self) -> None:
        """Give the last answer again."""

    def on_blind_tick(self, stamp: int, theta: Array, rates: Array, reason: str) -> None:
        """Answer a tick without touch, f* or k_f."""

    def on_restart(self) -> None:
        """Forget the past: ticks begin anew."""


class ControllerInputs:
    """Subscribes to joints, contacts, f*, k_f and, if asked, forces; joins those of one stamp.

    Where joint states keep coming without the others for a time-out, each of them is passed on
    alone and at once, until a complete set is seen again; see `InputWatch`.
    """

    def __init__(
        self,
        node: TactileNode[Any],
        hand: Hand,
        timeout: float,
        listener: TickListener,
        *,
        feels: bool,
    ) -> None:
        """Create the subscriptions.

        Args:
            node: The node.
            hand: Names joints and fingers.
            timeout: Time after which inputs count as missing [s].
            listener: Gets the ticks.
            feels: Whether the measured forces belong to a tick.
        """
        self._diagnostics = node.diagnostics
        self._listener = listener
        self._watch = InputWatch(timeout)
        self._reason = ""
        self._answered_blindly = -1
        self._joints = JointCodec(
            hand.joint_names, ("position", "velocity", "effort"), wanted=("position", "velocity")
        )
        self._contacts = ContactsCodec(hand.fingers)
        codecs = {names.GRASP_FORCE: WrenchCodec(names.PALM_FRAME, any_frame=True)}
        for name in hand.finger_names:
            frame = names.contact_frame(name)
            codecs[names.optimal_force(name)] = WrenchCodec(frame, nan_allowed=True)
        self._k = hand.fingers
        for name in hand.finger_names if feels else ():
            codecs[names.wrench(name)] = WrenchCodec(names.contact_frame(name))
        keys = (names.JOINT_STATES, names.CONTACTS, *codecs)
        self._backlog: Backlog[TickInputs] = Backlog(node, names.JOINT_STATES, self._answer)
        self._matcher = StampMatcher(keys, on_restart=self._restart)
        subscribe = partial(node.subscribe, raw=True)
        subscribe(JointState, names.JOINT_STATES, self._on_joints, sensor=True)
        subscribe(PoseArray, names.CONTACTS, self._on_contacts, sensor=True)
        touch = {names.wrench(name) for name in hand.finger_names}
        for topic, codec in codecs.items():
            take = partial(self._on_force, topic, codec)
            subscribe(WrenchStamped, topic, take, sensor=topic in touch)

    def check_time(self, stamp: int) -> None:
        """Check that something for a later tick [ns] is not stamped by another clock.

        Raises:
            MessageError: If it is more than a day ahead of the ticks. Before the first one
                nobody can tell; check again then.
        """
        last = self._matcher.last
        if last is not None and stamp > last + DAY_NS:
            raise MessageError(far_ahead(stamp, last))

    def report(self) -> None:
        """Name what is missing now."""
        missing = self._matcher.missing() if self._watch.blind else []
        if missing:
            self._complain(missing)

    def _complain(self, missing: Sequence[str]) -> None:
        self._reason = f"no {', '.join(missing)}; holding the hand until all inputs are back"
        self._diagnostics.fault("inputs", self._reason)

    def _restart(self) -> None:
        self._answered_blindly = -1
        self._backlog.clear()
        self._listener.on_restart()

    def _on_joints(self, data: bytes) -> None:
        stamp, joints = self._joints.decode(data)
        matched = self._matcher.put(names.JOINT_STATES, stamp, joints)
        if matched is REPEAT:
            self._backlog.repeat(self._listener.on_repeat)
        elif matched is not None:
            self._complete(stamp, matched)
        else:
            self._wait(stamp, *joints)

    def _wait(self, stamp: int, theta: Array, rates: Array) -> None:
        was_blind = self._watch.blind
        if self._watch.triggered(stamp):
            if not was_blind:
                self._complain(self._matcher.missing(stamp))
            self._answered_blindly = stamp
            self._listener.on_blind_tick(stamp, theta, rates, self._reason)

    def _on_contacts(self, data: bytes) -> None:
        stamp, poses = self._contacts.decode(data)
        self._take(names.CONTACTS, stamp, Contacts.from_poses(*poses))

    def _on_force(self, topic: str, codec: WrenchCodec, data: bytes) -> None:
        stamp, force = codec.decode(data)
        self._take(topic, stamp, force)

    def _take(self, key: str, stamp: int, value: Any) -> None:
        matched = self._matcher.put(key, stamp, value)
        if matched is not None and matched is not REPEAT:
            self._complete(stamp, matched)

    def _complete(self, stamp: int, matched: tuple[Any, ...]) -> None:
        if self._watch.complete():
            self._diagnostics.clear("inputs")
        if stamp <= self._answered_blindly:
            return
        (theta, rates), contacts, grasp_force, *forces = matched
        optimal, felt = np.array(forces[: self._k]), forces[self._k :]
        k_f, measured = float(grasp_force[1]), np.array(felt) if felt else None
        inputs = TickInputs(stamp, theta, rates, contacts, optimal, k_f, measured)
        self._backlog.put(stamp, inputs)

    def _answer(self, _: int, inputs: TickInputs) -> None:
        self._listener.on_tick(inputs)
