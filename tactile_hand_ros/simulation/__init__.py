# SPDX-License-Identifier: Apache-2.0
"""The simulation: dynamics (3) (5) (6), contact, solids, skin, disturbances."""
