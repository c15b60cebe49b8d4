# SPDX-License-Identifier: Apache-2.0
"""The tactile sensor: what a skin would report of the true contacts."""
