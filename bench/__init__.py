# SPDX-License-Identifier: Apache-2.0
"""Measurements of speed; they import the package, and nothing imports them."""
