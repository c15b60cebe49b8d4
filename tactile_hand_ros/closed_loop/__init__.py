# SPDX-License-Identifier: Apache-2.0
"""Scenarios, and the closed loop of one, in-process."""
