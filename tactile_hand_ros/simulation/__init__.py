# SPDX-License-Identifier: Apache-2.0
"""What exists only in simulation: dynamics (3) (5) (6), contact, solids, skin, disturbances."""
