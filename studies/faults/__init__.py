# SPDX-License-Identifier: Apache-2.0
"""The fault campaign: what becomes of the object when a part of the running hand fails."""
