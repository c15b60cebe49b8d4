# SPDX-License-Identifier: Apache-2.0
"""Where the hand is to bring its grasp, and when."""
