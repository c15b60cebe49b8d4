# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand move`, `squeeze`, `grasp`, `release` and `reset`: steering a running hand."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_hand_ros.errors import ConfigurationError

if TYPE_CHECKING:
    from tactile_hand_ros.orchestrator.steering import HandClient

NamespaceOption = Annotated[str, typer.Option(help="Namespace of the hand, as /left.")]
TimeoutOption = Annotated[
    float, typer.Option(min=0.1, help="Longest wait for the hand and for its answer [s].")
]

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_TIMEOUT = 5.0


def move(
    x: Annotated[float, typer.Argument(help="p_d of the contact centroid, palm frame [m].")],
    y: Annotated[float, typer.Argument(help="The same.")],
    z: Annotated[float, typer.Argument(help="The same.")],
    rotate: Annotated[
        tuple[str, float] | None,
        typer.Option(
            metavar="AXIS ANGLE", help="Turn from here about x, y or z of the palm [degrees]."
        ),
    ] = None,
    rotation: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="RX RY RZ",
            help="The orientation itself, as rotation vector in the palm frame [degrees].",
        ),
    ] = None,
    namespace: NamespaceOption = "",
    timeout: TimeoutOption = _TIMEOUT,
) -> None:
    """Move the object in a running hand; without a rotation it keeps its orientation.

    Exit code 0: the hand accepts the pose; 2: it refuses, or there is no hand.
    """
    if rotate is not None and rotation is not None:
        raise ConfigurationError("--rotate and --rotation are given; give one")
    turn = rotation if rotation is not None else _turn(rotate)
    with _hand(namespace, timeout) as hand:
        radians = [math.radians(v) for v in turn]
        since, vector = hand.move([x, y, z], radians, absolute=rotation is not None)
    degrees = ", ".join(f"{round(math.degrees(v), 3) + 0.0:g}" for v in vector)
    print(
        f"the target is ({x:g}, {y:g}, {z:g}) m, rotation ({degrees}) degrees, from "
        f"t = {since:.3f} s on"
    )


def squeeze(
    force: Annotated[float, typer.Argument(help="k_f [N].")],
    namespace: NamespaceOption = "",
    timeout: TimeoutOption = _TIMEOUT,
) -> None:
    """Request a grasp force from a running hand.

    Exit code 0: the hand accepts it; 2: it refuses, or there is no hand.
    """
    with _hand(namespace, timeout) as hand:
        since, mode = hand.grasp_force(force)
    print(f"a grasp force of {force:g} N is requested from t = {since:.3f} s")
    if mode == "auto":
        print("in mode auto the slip regulator chooses the force itself: this changes nothing")


def grasp(namespace: NamespaceOption = "", timeout: TimeoutOption = _TIMEOUT) -> None:
    """Close the fingers of a running hand until all touch, and hold what they touch."""
    with _hand(namespace, timeout) as hand:
        print(hand.grasp(True))


def release(namespace: NamespaceOption = "", timeout: TimeoutOption = _TIMEOUT) -> None:
    """Open the fingers of a running hand: an object without support falls."""
    with _hand(namespace, timeout) as hand:
        print(hand.grasp(False))


def reset(namespace: NamespaceOption = "", timeout: TimeoutOption = _TIMEOUT) -> None:
    """Put a running simulation back to its start; a real hand forgets grasp and targets."""
    with _hand(namespace, timeout) as hand:
        print(hand.reset())


def _turn(rotate: tuple[str, float] | None) -> tuple[float, ...]:
    """Return the rotation vector of an axis and an angle, in degrees."""
    if rotate is None:
        return (0.0, 0.0, 0.0)
    axis, angle = rotate
    if axis.lower() not in _AXES:
        raise ConfigurationError(f"--rotate: the axis is '{axis}', expected x, y or z")
    return tuple(angle * part for part in _AXES[axis.lower()])


@contextlib.contextmanager
def _hand(namespace: str, timeout: float) -> Iterator[HandClient]:
    """Join the graph of a hand."""
    from tactile_hand_ros.compiled import run_interpreted

    run_interpreted()  # a few rotations do not justify loading Numba
    from tactile_hand_ros.ros.middleware import check_environment

    check_environment(os.environ)  # before rclpy is loaded, which ends the process
    from tactile_hand_ros.orchestrator.steering import HandClient
    from tactile_hand_ros.ros import middleware

    place, name = middleware.full_namespace(namespace), f"user_{os.getpid()}"
    with (
        middleware.ros_context() as context,
        middleware.graph_node(context, name, place) as node,
    ):
        yield HandClient(node, timeout)


COMMANDS = (grasp, release, reset)
"""All but `move` and `squeeze`, which take negative numbers as arguments."""
