# SPDX-License-Identifier: Apache-2.0
"""Hold and turn an unknown object with a tactile prosthetic hand, on ROS 2.

`control` is what runs on a real hand and `simulation` what replaces one; both are plain NumPy.
`ros` knows rclpy, `nodes` has one folder per process, `bag`, `run`, `verify` and `report` work
on recordings.
"""

__version__ = "0.1.0"
