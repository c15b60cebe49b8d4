# SPDX-License-Identifier: Apache-2.0
"""One run per ROS domain and namespace on a machine: a hand must not get two masters."""

from __future__ import annotations

import socket

from tactile_hand_ros.errors import TactileHandError


class ClaimedError(TactileHandError):
    """Another run is in progress at the same place."""


def claim(domain: int, namespace: str) -> socket.socket:
    """Claim a domain and namespace on this machine.

    The claim is a name among the abstract sockets. It ends with the last process that holds the
    socket, however it dies, and leaves no file behind.

    Args:
        domain: ROS domain id.
        namespace: Namespace of the run.

    Returns:
        The socket; it is the claim as long as a process holds it.

    Raises:
        ClaimedError: If another run holds it.
    """
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(f"\0tactile_hand_ros/{domain}{namespace}")
    except OSError:
        held.close()
        raise ClaimedError(
            f"a run is in progress in ROS domain {domain} and namespace '{namespace}'; stop it, or"
            " give this one another --namespace or ROS_DOMAIN_ID"
        ) from None
    return held
