# SPDX-License-Identifier: Apache-2.0
"""The recorder: all messages of the graph, as raw bytes, in a rosbag2 folder."""
