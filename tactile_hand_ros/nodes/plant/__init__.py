# SPDX-License-Identifier: Apache-2.0
"""The plant: the simulated hand and object."""
