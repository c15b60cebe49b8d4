# SPDX-License-Identifier: Apache-2.0
"""The slip study: how fast slip is found and stopped, and at what squeeze."""
