# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs by the thousand: nothing dies, hangs, grows or moves the hand unsafely."""
