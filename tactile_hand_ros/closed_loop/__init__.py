# SPDX-License-Identifier: Apache-2.0
"""Scenarios, and the whole loop of one by function calls."""
