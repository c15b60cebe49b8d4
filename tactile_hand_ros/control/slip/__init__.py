# SPDX-License-Identifier: Apache-2.0
"""Slip prevention: split of forces, detector, learned friction, need, reflex, regulator."""
