# SPDX-License-Identifier: Apache-2.0
"""The hand: from a URDF to kinematics, Jacobians and dynamics."""
