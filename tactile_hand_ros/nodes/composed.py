# SPDX-License-Identifier: Apache-2.0
"""All five nodes in one process on one executor, for computers with few cores.

With ``--record`` the recorder shares the process, too: it notes the bytes that the nodes hand to
each other, and a small process of its own packs them and writes them to the disk.

Topics, parameters, services and results are those of separate processes, to the bit. The nodes hand
their messages to each other (`ros.direct`), and DDS gets a copy only while another process listens.
What is lost is isolation: they all die together, and the drivers of a real hand must then hold the
joints. With cores to spare, separate processes are the safer choice.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from tactile_hand_ros.names import RECORD
from tactile_hand_ros.nodes.force_optimizer.node import ForceOptimizerNode
from tactile_hand_ros.nodes.manipulation_controller.node import ManipulationControllerNode
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.nodes.slip_regulator.node import SlipRegulatorNode
from tactile_hand_ros.nodes.tactile_sensor.node import TactileSensorNode
from tactile_hand_ros.ros.runner import run_nodes

MEMBERS = (
    ManipulationControllerNode,
    ForceOptimizerNode,
    TactileSensorNode,
    SlipRegulatorNode,
    PlantNode,
)


def main(args: Sequence[str] | None = None) -> int:
    """Run all nodes until SIGINT or SIGTERM and return the exit code.

    Args:
        args: Command line; ``--params-file`` may be given once for each node.
    """
    line = list(sys.argv if args is None else args)
    if RECORD not in line:
        return run_nodes(MEMBERS, line)
    from tactile_hand_ros.nodes.recorder.node import RecorderNode

    line.remove(RECORD)
    return run_nodes((RecorderNode, *MEMBERS), line)  # the first is the last to close


if __name__ == "__main__":
    sys.exit(main())
