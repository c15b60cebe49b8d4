# SPDX-License-Identifier: Apache-2.0
"""The paper in plain Python: no ROS, no clock, no input or output beyond configuration files."""
