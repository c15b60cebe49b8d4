# SPDX-License-Identifier: Apache-2.0
"""The controllers, which also run on a real hand: they use joints and touch only.

This folder imports neither the simulation nor ROS nor a clock.
"""
