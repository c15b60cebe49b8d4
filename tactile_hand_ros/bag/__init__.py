# SPDX-License-Identifier: Apache-2.0
"""Bags in the format of rosbag2 (Jazzy): MCAP writing, reading, recovery and metadata."""
