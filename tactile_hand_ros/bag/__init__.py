# SPDX-License-Identifier: Apache-2.0
"""Bags as rosbag2 (Jazzy) writes them: MCAP writing, reading and the texts around them."""
