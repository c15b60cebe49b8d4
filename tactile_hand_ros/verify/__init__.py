# SPDX-License-Identifier: Apache-2.0
"""Verification of a run by recomputation."""
