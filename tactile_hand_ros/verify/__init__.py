# SPDX-License-Identifier: Apache-2.0
"""Whether a run is what it claims to be: recompute it."""
