# SPDX-License-Identifier: Apache-2.0
"""The slip regulator: how hard the hand squeezes."""
