# SPDX-License-Identifier: Apache-2.0
"""The fault campaign: what happens to the object when a part of the running hand fails."""
