# SPDX-License-Identifier: Apache-2.0
"""What a process does to keep its ticks on time, and how it explains those that are late."""
