# SPDX-License-Identifier: Apache-2.0
"""Each marker has its place, length and shape; what is not known is not drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from visualization_msgs.msg import Marker

from tactile_hand_ros.nodes.viewer.scene import Frame, Scene, markers

TURN = np.array([0.1, 0.2, 0.3, np.sqrt(0.86)])
CORNERS = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]])
FORCES = np.array([[1.0, 4.0, -2.0], [0.5, -1.0, 0.25], [0.0, 0.0, 0.0], [3.0, 8.0, 6.0]])


def frame(name: str, number: int) -> Frame:
    return Frame(name, np.array([number, number + 0.25, number + 0.5]), TURN)


def scene(**changes: Any) -> Scene:
    """Five fingers, one of which feels nothing, with all that can be known."""
    parts: dict[str, Any] = {
        "corners": CORNERS,
        "object": frame("object", 7),
        "contacts": [frame(f"c{number}", number) for number in range(5)],
        "forces": np.vstack([FORCES, FORCES[:1]]),
        "friction": np.array([0.5, 0.5, 0.5, 9.0, np.nan]),
        "goal": frame("goal", 8),
    }
    return Scene(**{**parts, **changes})


def found(drawn: Scene, namespace: str) -> dict[int, Marker]:
    return {m.id: m for m in markers(drawn).markers if m.ns == namespace}


def points(marker: Marker) -> np.ndarray[Any, Any]:
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def place(marker: Marker) -> list[float]:
    at, turn = marker.pose.position, marker.pose.orientation
    return [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]


def at(number: int) -> list[float]:
    return [number, number + 0.25, number + 0.5, *TURN]


def test_a_force_is_an_arrow_and_the_strongest_is_twelve_centimetres_long() -> None:
    arrows = found(scene(), "forces")
    assert sorted(arrows) == [0, 1, 3, 4]  # where nothing is felt there is none
    for i, arrow in arrows.items():
        start, end = points(arrow)
        assert not start.any()
        np.testing.assert_allclose(end, [*FORCES, FORCES[0]][i] * 0.12 / np.sqrt(109.0))
        assert arrow.type == Marker.ARROW and place(arrow) == at(i)


def test_a_cone_is_as_high_as_its_force_and_no_wider_than_can_be_seen() -> None:
    """None for a force that pulls, and none where friction is not known."""
    cones = found(scene(), "cones")
    assert sorted(cones) == [0, 3]
    for i, friction in ((0, 0.5), (3, 2.5)):
        height = FORCES[i, 1] * 0.12 / np.sqrt(109.0)
        corners = points(cones[i]).reshape(-1, 3, 3)
        assert len(corners) == 24 and not corners[:, 0].any()
        angles = np.linspace(0.0, 2.0 * np.pi, 25)
        x, z = friction * height * np.cos(angles), friction * height * np.sin(angles)
        rim = np.stack([x, np.full(25, height), z], axis=1)
        np.testing.assert_allclose(corners[:, 1], rim[:-1], atol=1e-12)
        np.testing.assert_allclose(corners[:, 2], rim[1:], atol=1e-12)
        assert cones[i].type == Marker.TRIANGLE_LIST and place(cones[i]) == at(i)


@pytest.mark.parametrize(
    ("changes", "missing"),
    [
        ({"object": None}, "object"),
        ({"object": Frame("object", np.full(3, np.nan), TURN)}, "object"),
        ({"corners": np.empty((0, 3))}, "object"),
        ({"goal": None}, "goal"),
        ({"goal": Frame("goal", np.zeros(3), np.full(4, np.nan))}, "goal"),
    ],
)
def test_what_is_not_known_is_not_drawn(changes: dict[str, Any], missing: str) -> None:
    seen = [m.ns for m in markers(scene()).markers]
    assert [m.ns for m in markers(scene(**changes)).markers] == [n for n in seen if n != missing]


@pytest.mark.parametrize("force", [[np.nan, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, np.inf, 0.0]])
def test_a_force_that_is_not_known_leaves_the_ball(force: list[float]) -> None:
    forces = np.array([force])
    drawn = scene(contacts=[frame("c", 1)], forces=forces, friction=np.array([0.5]))
    with np.errstate(invalid="ignore"):
        assert [m.ns for m in markers(drawn).markers] == ["all", "object", "contacts", "goal"]
