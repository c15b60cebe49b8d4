# SPDX-License-Identifier: Apache-2.0
"""What touches rclpy but is no node: names, conversions, parameters, spinning, test support."""
