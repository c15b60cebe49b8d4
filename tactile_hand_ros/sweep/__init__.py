# SPDX-License-Identifier: Apache-2.0
"""Sweeps: scenarios over any of their parameters."""
