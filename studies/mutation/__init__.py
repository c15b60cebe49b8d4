# SPDX-License-Identifier: Apache-2.0
"""Mutation testing: change a line on purpose and see whether a test notices."""
