# SPDX-License-Identifier: Apache-2.0
"""What was known shortly before is between one and two ages old."""

from tactile_hand_ros.control.slip.regulator import AGE, RollbackBuffer

TICK = 3_000_000


def test_what_was_known_is_between_one_and_two_ages_old():
    kept = RollbackBuffer()
    assert kept.before is None
    for now in range(0, 20 * AGE, TICK):
        kept.pass_by(now, lambda known=now: known)
        if now >= 2 * AGE:
            assert AGE <= now - kept.before <= 2 * (AGE + TICK)
        else:
            assert kept.before == 0 or now > AGE


def test_a_new_grasp_has_no_past():
    kept = RollbackBuffer()
    kept.pass_by(0, lambda: "old")
    kept.forget()
    assert kept.before is None
