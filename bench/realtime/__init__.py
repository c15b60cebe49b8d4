# SPDX-License-Identifier: Apache-2.0
"""Measurements of real time: which rates a computer sustains, and what that does to the grip."""
