# SPDX-License-Identifier: Apache-2.0
"""Compilation of numeric functions with Numba; the same source runs without it."""
