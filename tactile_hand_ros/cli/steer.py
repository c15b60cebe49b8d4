# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand move`, `squeeze`, `grasp`, `release` and `reset`: steer a running hand."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tactile_hand_ros.orchestrator.steering import HandClient

NamespaceOption = Annotated[str, typer.Option(help="Namespace of the hand, such as /left.")]
TimeoutOption = Annotated[
    float,
    typer.Option(min=0.1, metavar="SECONDS", help="Timeout for the hand and for its answer [s]."),
]

_TIMEOUT = 5.0


def move(
    x: Annotated[
        float,
        typer.Argument(metavar="X", help="x of the contact centroid's target, palm frame [m]."),
    ],
    y: Annotated[float, typer.Argument(metavar="Y", help="Its y [m].")],
    z: Annotated[float, typer.Argument(metavar="Z", help="Its z [m].")],
    rotation: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="RX RY RZ",
            help="Its orientation as a rotation vector in the palm frame [degrees].",
        ),
    ] = None,
    namespace: NamespaceOption = "",
    timeout: TimeoutOption = _TIMEOUT,
) -> None:
    """Move the object in a running hand.

    Without --rotation it keeps its orientation. Exit code 0: the hand accepts the pose; 2: it
    refuses, or there is no hand.
    """
    turn = None if rotation is None else [math.radians(v) for v in rotation]
    with _hand(namespace, timeout) as hand:
        since, vector = hand.move([x, y, z], turn)
    degrees = ", ".join(f"{round(math.degrees(v), 3) + 0.0:g}" for v in vector)
    print(
        f"the target is ({x:g}, {y:g}, {z:g}) m, rotation ({degrees}) degrees, from "
        f"t = {since:.3f} s on"
    )


def squeeze(
    force: Annotated[float, typer.Argument(metavar="NEWTONS", help="k_f [N].")],
    namespace: NamespaceOption = "",
    timeout: TimeoutOption = _TIMEOUT,
) -> None:
    """Request a grasp force from a running hand.

    With slip_regulator.mode auto the regulator chooses its own. Exit code 0: the hand accepts it;
    2: it refuses, or there is no hand.
    """
    with _hand(namespace, timeout) as hand:
        since = hand.grasp_force(force)
    print(f"a grasp force of {force:g} N is requested from t = {since:.3f} s")


def grasp(
    hand: Annotated[str, typer.Argument(help="Find a grasp of this hand: name or YAML file.")] = "",
    edges: Annotated[
        list[float] | None,
        typer.Argument(metavar="[EDGE]...", help="Edge of the cube, or three of a box [m]."),
    ] = None,
    shape: Annotated[
        str,
        typer.Option(help="box, cylinder, sphere or capsule; of a round one: diameter and length."),
    ] = "box",
    friction: Annotated[float, typer.Option(help="Friction coefficient.", min=0.01)] = 0.5,
    mass: Annotated[
        float,
        typer.Option(
            metavar="KG", help="Mass [kg]; 0 for a fifth of the limit, at most 0.2.", min=0.0
        ),
    ] = 0.0,
    out: Annotated[Path, typer.Option(help="Folder of scenario and picture.")] = Path("my"),
    namespace: NamespaceOption = "",
    timeout: TimeoutOption = _TIMEOUT,
) -> None:
    """Close the fingers, or find a grasp of HAND.

    Without HAND, the fingers of the running hand close until all touch. With HAND and EDGE, search
    for grasps of an object and write a scenario that is ready to run.
    """
    if hand:
        from tactile_hand_ros.cli.grasps import find_grasp

        find_grasp(hand, edges or [], shape, friction, mass, out)
        return
    with _hand(namespace, timeout) as running:
        print(running.grasp(True))


def release(namespace: NamespaceOption = "", timeout: TimeoutOption = _TIMEOUT) -> None:
    """Open the fingers of a running hand; the object may fall."""
    with _hand(namespace, timeout) as hand:
        print(hand.grasp(False))


def reset(namespace: NamespaceOption = "", timeout: TimeoutOption = _TIMEOUT) -> None:
    """Return a running simulation to its start.

    A real hand forgets its grasp and its targets.
    """
    with _hand(namespace, timeout) as hand:
        print(hand.reset())


@contextlib.contextmanager
def _hand(namespace: str, timeout: float) -> Iterator[HandClient]:
    """Join the graph of a hand."""
    from tactile_hand_ros.compiled import run_interpreted

    run_interpreted()  # a few rotations do not justify loading Numba
    from tactile_hand_ros.ros.middleware import check_environment

    check_environment(os.environ)  # before rclpy is loaded: it would end the process
    from tactile_hand_ros.orchestrator.steering import HandClient
    from tactile_hand_ros.ros import middleware

    place, name = middleware.full_namespace(namespace), f"user_{os.getpid()}"
    with (
        middleware.ros_context() as context,
        middleware.graph_node(context, name, place) as node,
    ):
        yield HandClient(node, timeout)


COMMANDS = (move, squeeze, grasp, release, reset)
