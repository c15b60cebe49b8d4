# SPDX-License-Identifier: Apache-2.0
"""Steering a running hand from another process."""
