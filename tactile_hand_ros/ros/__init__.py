# SPDX-License-Identifier: Apache-2.0
"""Everything that uses rclpy except the nodes: conversions, parameters, executor, middleware."""
