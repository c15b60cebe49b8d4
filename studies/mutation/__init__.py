# SPDX-License-Identifier: Apache-2.0
"""Mutation testing: change a line on purpose and check whether a test fails."""
