# SPDX-License-Identifier: Apache-2.0
"""The force optimizer: how the fingers share the squeeze, (13)."""
