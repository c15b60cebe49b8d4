# SPDX-License-Identifier: Apache-2.0
"""A run on disk: load it, align its topics, measure it."""
