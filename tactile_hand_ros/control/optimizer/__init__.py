# SPDX-License-Identifier: Apache-2.0
"""The grasp-force optimization (13): exact active set, OSQP, friction cones."""
