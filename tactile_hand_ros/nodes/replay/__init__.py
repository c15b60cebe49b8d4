# SPDX-License-Identifier: Apache-2.0
"""The replay: the bytes of a bag on its topics, with its timing."""
