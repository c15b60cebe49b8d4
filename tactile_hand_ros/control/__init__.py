# SPDX-License-Identifier: Apache-2.0
"""What runs on a real hand: contact geometry, grasp map, laws, controller, holds, margins.

Blind: joints and touch only; nothing here imports the simulation, ROS or a clock.
"""
