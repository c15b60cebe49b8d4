# SPDX-License-Identifier: Apache-2.0
"""Hold and turn an unknown object with a tactile prosthetic hand, on ROS 2.

The paper lives in `core` (plain NumPy, no ROS), `ros` knows rclpy, `nodes` joins the two in one
thin file per process, `bag` records and reads, `analysis` measures and draws.
"""

__version__ = "0.1.0"
