# SPDX-License-Identifier: Apache-2.0
"""Changes of mode are logged, a flood of them is not."""

from tactile_hand_ros.nodes.common import ModeLog


def test_five_lines_a_second_and_the_count_begins_again_each_second() -> None:
    lines: list[str] = []
    now = [7.0]
    log = ModeLog(lines.append, lambda: now[0])
    log.note("hold")
    for time, expected in ((7.0, 5), (7.999, 0), (8.0, 5), (9.5, 5), (10.0, 0)):
        now[0] = time
        lines.clear()
        for change in range(6):
            log.note("drive" if change % 2 else "hold", f"{change}")
            log.note("other")
        assert len(lines) == expected, time
        if time in (8.0, 9.5):
            assert "changes before it not logged" in lines[0]
            assert not any("not logged" in line for line in lines[1:])
