# SPDX-License-Identifier: Apache-2.0
"""The slip studies: how fast slip is found and stopped, and at what grasp force."""
