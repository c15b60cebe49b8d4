# SPDX-License-Identifier: Apache-2.0
"""Slip prevention: detector, learned friction, required grasp force, reflex, regulator."""
