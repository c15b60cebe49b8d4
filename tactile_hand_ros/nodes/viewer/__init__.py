# SPDX-License-Identifier: Apache-2.0
"""The viewer: frames and markers for RViz and Foxglove."""
