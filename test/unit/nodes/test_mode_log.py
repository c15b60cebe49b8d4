# SPDX-License-Identifier: Apache-2.0
"""Changes of mode are logged, with a rate limit."""

from tactile_hand_ros.nodes.common import ModeLog


def test_each_change_is_one_line_with_its_reason_and_of_a_flood_five_a_second():
    lines: list[str] = []
    now = [7.0]
    log = ModeLog(lines.append, lambda: now[0])
    for mode, reason in (("drive", ""), ("drive", ""), ("hold", "no contact"), ("drive", "")):
        log.note(mode, reason)
    assert lines == ["drive -> hold: no contact", "hold -> drive"]
    ModeLog(lines.append).note("hold", "no touch yet")
    assert lines.pop() == "hold: no touch yet"
    for now[0], expected in ((7.999, 3), (8.0, 5), (8.999, 0), (9.0, 5)):
        lines.clear()
        for change in range(100):
            log.note("drive" if change % 2 else "hold", f"{change}")
        assert len(lines) == expected and lines[:1] in ([], ["drive -> hold: 0"])
