# SPDX-License-Identifier: Apache-2.0
"""A node gets complete ticks, the trigger alone after a timeout, and no tick twice."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tactile_hand_ros import names
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.ros import streams
from tactile_hand_ros.ros.diagnostics import ERROR, Diagnostics
from tactile_hand_ros.ros.messages import ContactsCodec, JointCodec, WrenchCodec
from tactile_hand_ros.ros.ticks import TickInputs
from tactile_hand_ros.rotations import rotation_from_quaternion

MS = 1_000_000
HAND = Hand.load("paper")
FINGERS = HAND.finger_names
THETA, RATES = np.linspace(0.1, 0.9, 9), np.linspace(-2.0, 3.0, 9)
POSITIONS = np.arange(9.0).reshape(3, 3)
TURNS = np.array([[0.6, 0.0, 0.8, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])
JOINTS = JointCodec(HAND.joint_names, ("position", "velocity", "effort"))


class Ear:
    """A minimal node for inputs and their listener; sends messages and keeps what is received."""

    bad = -1
    """Timestamp of a tick that cannot be answered [ns]."""

    def __init__(self, *, observes: bool = False) -> None:
        self.now = self.number = 0
        self.diagnostics = Diagnostics("ear")
        self.callbacks: dict[str, Callable[..., None]] = {}
        self.heard: list[tuple[Any, ...]] = []
        rest = streams.contacts(3), streams.optimal_forces(FINGERS), streams.forces(FINGERS)
        declared = (streams.joints(HAND.joint_names), streams.grasp_force(), *rest)
        options: Any = {"silence": 0.5, "observe": self.on_skipped_tick if observes else None}
        self.inputs = TickInputs(self, declared, self, clock=lambda: self.now, **options)
        self.reads_late = False
        self.waiting: list[Callable[[], None]] = []
        self.rejected: list[tuple[str, str]] = []

    def subscribe(self, kind: Any, topic: str, callback: Any, **options: Any) -> None:
        assert options["raw"]
        self.callbacks[topic] = callback

    def guarded(self, source: str, callback: Callable[[], None]) -> Callable[[], None]:
        return callback

    @property
    def executor(self) -> Any:
        """The executor that calls back after reading, if known."""
        return self if self.reads_late else None

    def after_reading(self, callback: Callable[[], None]) -> None:
        self.waiting.append(callback)

    def has_read(self) -> None:
        """Call the callback at the end of reading; there is one call for all ticks."""
        [callback], self.waiting = self.waiting, []
        callback()

    def reject(self, topic: str, error: TactileHandError) -> None:
        self.rejected.append((topic, str(error)))

    def survive(self, source: str, error: Exception) -> None:
        self.rejected.append((source, repr(error)))

    def on_tick(self, stamp: int, *values: Any) -> None:
        if stamp == self.bad:
            raise TactileHandError("no answer to this tick")
        self.heard.append(("tick", stamp, values))

    def on_skipped_tick(self, stamp: int, *values: Any) -> None:
        if stamp == self.bad:
            raise KeyError("left")
        self.heard.append(("skipped", stamp, values))

    def on_repeat(self) -> None:
        self.heard.append(("repeat",))

    def on_blind_tick(self, stamp: int, joints: Joints, reason: str) -> None:
        self.heard.append(("blind", stamp, *joints[:2], reason))

    def on_restart(self) -> None:
        self.heard.append(("restart",))

    def joints(self, stamp: int) -> None:
        """Send joint states, which differ by their tick [ms]."""
        data = JOINTS.encode(stamp * MS, THETA + stamp, RATES - stamp, 0.0 * THETA)
        self.number += 1
        self.bring(data, self.number)

    def bring(self, joints: bytes, number: int) -> None:
        """Send joint states with a publisher's sequence numbers."""
        info = {"publication_sequence_number": number}
        self.callbacks[names.JOINT_STATES](joints, info)

    def others(self, stamp: int, *, without: str = "") -> None:
        """Send all other messages of a tick [ms], with other numbers for each finger."""
        at = stamp * MS
        data = {
            names.CONTACTS: ContactsCodec(3).encode(POSITIONS + stamp, TURNS, at),
            names.GRASP_FORCE: WrenchCodec("palm").encode((7.0, 10.0 + stamp, 8.0), at),
        }
        for i, name in enumerate(FINGERS):
            codec = WrenchCodec(names.contact_frame(name))
            data[names.optimal_force(name)] = codec.encode((0.1, 0.2 + i, 0.3), at)
            data[names.wrench(name)] = codec.encode((1.0, 2.0, 3.0 + i), at)
        for topic, message in data.items():
            if topic in self.callbacks and topic != without:
                self.callbacks[topic](message)

    def kinds(self) -> list[Any]:
        """Return what was received since the last call, with timestamps [ms] of ticks."""
        heard, self.heard = self.heard, []
        return [(entry[0], entry[1] // MS) if len(entry) > 1 else entry[0] for entry in heard]

    def go_blind(self, first: int) -> int:
        """Send joints alone until they are answered; return the tick [ms] of that answer."""
        self.joints(first)
        self.now += 500 * MS
        for stamp in range(first + 100, first + 501, 100):
            self.joints(stamp)
        assert self.kinds() == [("blind", first + 500)]
        return first + 500

    @property
    def fault(self) -> str:
        values = {pair.key: pair.value for pair in self.diagnostics.status().values}
        return values.get("fault inputs", "")


def complete(node: Ear, *ticks: int) -> None:
    """Send complete ticks [ms]."""
    for tick in ticks:
        node.joints(tick)
        node.others(tick)


def complete_together(node: Ear, *ticks: int) -> None:
    """Send complete ticks [ms] that wait until all are read."""
    node.reads_late = True
    complete(node, *ticks)
    node.has_read()


@pytest.fixture
def ear() -> Ear:
    return Ear()


@pytest.mark.parametrize("joints_first", [True, False])
def test_a_tick_has_everything_in_its_place(joints_first):
    ear = Ear()
    for part in (ear.joints, ear.others) if joints_first else (ear.others, ear.joints):
        assert ear.heard == []
        part(4)
    [(kind, stamp, (joints, grasp_force, contacts, optimal, forces))] = ear.heard
    assert (kind, stamp) == ("tick", 4 * MS)
    np.testing.assert_array_equal(joints.theta, THETA + 4)
    np.testing.assert_array_equal(joints.rates, RATES - 4)
    np.testing.assert_array_equal(contacts.positions, POSITIONS + 4)
    np.testing.assert_allclose(contacts.rotations, rotation_from_quaternion(TURNS))
    assert grasp_force == 14.0
    np.testing.assert_array_equal(optimal, [[0.1, 0.2, 0.3], [0.1, 1.2, 0.3], [0.1, 2.2, 0.3]])
    np.testing.assert_array_equal(forces, [[1, 2, 3], [1, 2, 4], [1, 2, 5]])


def test_in_lockstep_a_tick_is_waited_for_however_long_it_takes(ear):
    """The plant resends it repeatedly; the answer is that of a fast machine."""
    complete(ear, 2)
    for _ in range(50):
        ear.joints(4)
        ear.now += 100 * MS
    assert ear.kinds() == [("tick", 2)] and ear.fault == ""
    ear.others(4)
    assert ear.kinds() == [("tick", 4)]


def test_joints_that_stay_alone_for_the_time_out_are_passed_on_with_the_reason(ear):
    complete(ear, 2)
    assert ear.kinds() == [("tick", 2)]
    for stamp in range(4, 504, 4):
        ear.joints(stamp)
        ear.others(stamp, without=names.optimal_force(FINGERS[1]))
        ear.now += 4 * MS
    assert ear.kinds() == [] and ear.fault == ""
    ear.others(504, without=names.optimal_force(FINGERS[1]))
    ear.joints(504)
    [(kind, stamp, theta, rates, reason)] = ear.heard
    assert (kind, stamp) == ("blind", 504 * MS)
    np.testing.assert_array_equal(theta, THETA + 504)
    np.testing.assert_array_equal(rates, RATES - 504)
    expected = f"no optimal_force/{FINGERS[1]}; holding the hand until all inputs are back"
    assert reason == ear.fault == expected
    assert ear.diagnostics.status().level == ERROR
    assert ear.kinds() == [("blind", 504)]
    ear.joints(508)  # immediately from now on
    assert ear.kinds() == [("blind", 508)]


@pytest.mark.parametrize("late", [0, 300])
def test_only_what_is_silent_is_named_also_where_the_others_come_later(ear, late):
    """After their trigger or, as on a busy machine, 0.3 s late and for one tick in five."""
    for stamp in range(0, 508, 4):
        ear.joints(stamp)
        if stamp >= late and (late == 0 or stamp % 20 == 0):
            ear.others(stamp - late, without=names.GRASP_FORCE)
        ear.now += 4 * MS
    assert ear.fault == "no grasp_force; holding the hand until all inputs are back"


def test_all_that_is_missing_is_named_where_a_node_died_while_it_sent(ear):
    """Some inputs of the oldest tick have arrived; those that follow lack more."""
    ear.joints(0)
    ear.others(0, without=names.GRASP_FORCE)
    for stamp in range(20, 540, 20):
        ear.joints(stamp)
        ear.now += 20 * MS
    assert ear.fault.startswith("no ") and names.CONTACTS in ear.fault
    assert names.GRASP_FORCE in ear.fault


def test_no_tick_is_answered_after_one_that_was_answered_blindly(ear):
    """Late touch of that tick or an older one only ends the blindness."""
    at = ear.go_blind(2)
    ear.joints(at + 4)
    ear.joints(at + 8)
    assert ear.kinds() == [("blind", at + 4), ("blind", at + 8)]
    ear.others(at + 4)
    assert ear.kinds() == [] and ear.fault == ""
    ear.others(at + 8)
    assert ear.kinds() == []
    ear.joints(at + 9)
    assert ear.kinds() == []  # no longer blind: the timeout restarts
    ear.others(at + 9)
    assert ear.kinds() == [("tick", at + 9)]


def test_ticks_that_begin_anew_are_answered_although_later_ones_were_blindly(ear):
    complete(ear, 2)
    assert ear.kinds() == [("tick", 2)]
    ear.go_blind(4)
    ear.others(0)
    ear.joints(0)
    assert ear.kinds() == ["restart", ("tick", 0)]
    complete(ear, 2)
    assert ear.kinds() == [("tick", 2)]


def test_without_a_time_out_an_incomplete_tick_is_never_passed_on(ear):
    declared = (streams.joints(HAND.joint_names), streams.grasp_force())
    ear.inputs = TickInputs(ear, declared, ear)
    for stamp in range(0, 5000, 4):
        ear.joints(stamp)
    assert ear.heard == [] and ear.fault == ""
    ear.others(5000)
    ear.joints(5000)
    [(kind, stamp, (joints, grasp_force))] = ear.heard
    assert (kind, stamp, grasp_force) == ("tick", 5000 * MS, 5010.0)
    np.testing.assert_array_equal(joints.theta, THETA + 5000)


@pytest.mark.parametrize("observes", [True, False])
def test_of_ticks_that_wait_together_some_are_skipped_or_only_observed(observes):
    node = Ear(observes=observes)
    complete(node, 16)
    complete_together(node, 17, 18, 19)
    expected = [("skipped", 17), ("tick", 18), ("tick", 19)]
    assert node.kinds() == [("tick", 16), *(expected if observes else expected[1:])]
    values = {pair.key: pair.value for pair in node.diagnostics.status().values}
    assert values["ticks_left_out"] == "1"


def test_an_answer_is_not_repeated_when_a_newer_one_is_about_to_be_given(ear):
    complete(ear, 4)
    ear.reads_late = True
    complete(ear, 6)
    ear.joints(6)
    assert ear.kinds() == [("tick", 4)]
    ear.has_read()
    ear.others(6)
    ear.joints(6)
    assert ear.kinds() == [("tick", 6), "repeat"]


def test_a_tick_that_cannot_be_answered_is_reported_and_the_others_are_answered(ear):
    ear.bad = 24 * MS
    complete(ear, 16)
    complete_together(ear, 24, 28)
    assert ear.kinds() == [("tick", 16), ("tick", 28)]
    assert ear.rejected == [(names.JOINT_STATES, "no answer to this tick")]


def test_a_tick_is_answered_although_a_skipped_one_before_it_fails():
    node = Ear(observes=True)
    node.bad = 17 * MS
    complete(node, 16)
    complete_together(node, 17, 18, 19)
    assert node.kinds() == [("tick", 16), ("tick", 18), ("tick", 19)]
    assert node.rejected == [("ticks", "KeyError('left')")]


def test_ticks_that_wait_are_forgotten_when_the_stamps_start_over(ear):
    """And the first one is not skipped, as if it followed the previous ones."""
    complete(ear, 20)
    ear.reads_late = True
    complete(ear, 22, 0, 32)
    assert ear.kinds() == [("tick", 20), "restart"]
    for callback in ear.waiting:
        callback()
    assert ear.kinds() == [("tick", 0), ("tick", 32)]


def test_while_two_senders_send_the_trigger_no_tick_is_answered(ear):
    """The right joints cannot be identified; without an answer, the driver holds."""
    complete(ear, 1, 2)
    for number in (101, 102):
        ear.bring(JOINTS.encode(2 * MS, THETA, RATES, 0.0 * THETA), number)
        ear.joints(2)
    assert "two senders of joint_states" in ear.diagnostics.status().message
    ear.heard.clear()
    complete(ear, 3)
    assert ear.kinds() == []
    ear.now = 600 * MS  # it expires between two messages
    complete(ear, 4)
    assert "two senders" not in ear.diagnostics.status().message
    assert ear.kinds() == [("tick", 4)]


def test_ticks_before_the_last_are_reported_until_the_stamps_have_caught_up(ear):
    """The clock of a driver may be set back; more than a second is a restart."""
    complete(ear, 2000, 1950, 1998, 2002, 900)
    kinds = [kind for kind, *_ in ear.heard]
    assert kinds == ["tick", "tick", "restart", "tick"]
    texts = [text for topic, text in ear.rejected if topic == names.JOINT_STATES]
    assert len(texts) == 2 and "timestamp is 0.05 s before the last tick" in texts[0]


def test_the_tick_after_a_late_one_is_no_leap(ear):
    complete(ear, 2000, 1850, 2002)
    assert ear.kinds() == [("tick", 2000), ("tick", 2002)]


@pytest.mark.parametrize("ahead", [101, 900, 1_001, 10**6])
def test_one_stamp_far_ahead_does_not_silence_the_others(ear, ahead):
    for tick in range(0, 12, 2):
        if tick in (4, 8):
            complete(ear, tick + ahead)
        complete(ear, tick)
    assert ear.kinds() == [("tick", tick) for tick in range(0, 12, 2)]


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        # A second stamp as far ahead confirms the first.
        ((0, 3_000, 3_000), [0, 3_000]),
        ((0, 3_000, 3_001), [0, 3_001]),
        ((0, 3_000, 2_999), [0]),
        # One that continues refutes it.
        ((0, 3_000, 2, 3_000), [0, 2]),
        # A plant in lockstep repeats an unanswered tick; the next may be as far apart.
        ((0, 10_000, 10_000, 20_000), [0, 10_000, 20_000]),
    ],
)
def test_a_stamp_ahead_is_answered_when_it_is_confirmed(ear, sent, answered):
    complete(ear, *sent)
    assert [each for each in ear.kinds() if each != "repeat"] == [("tick", at) for at in answered]


def test_inputs_are_missing_when_the_time_out_has_passed_by_the_stamps_and_by_the_wall_clock(ear):
    """A single timestamp is no passing time, nor is a stopped clock; a step back restarts it."""
    for wall, stamp, heard in (
        (0, 10_000, []),
        (600, 3_000, []),
        (0, 3_499, []),
        (499, 3_500, []),
        (1, 3_501, ["blind"]),
        (0, 3_502, ["blind"]),
        (499, 3_503, []),  # the others of the last tick have come
        (499, 4_003, []),
        (1, 4_004, ["blind"]),
    ):
        if stamp == 3_503:
            ear.others(3_502)
        ear.now += wall * MS
        ear.joints(stamp)
        assert [kind for kind, *_ in ear.heard] == heard, stamp
        ear.heard.clear()
