# SPDX-License-Identifier: Apache-2.0
"""The cockpit: a live local page to watch a run, steer it, pull at the object and break things."""
