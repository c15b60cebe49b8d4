# SPDX-License-Identifier: Apache-2.0
"""The slip studies: how fast slip is detected and stopped, and at what grasp force."""
