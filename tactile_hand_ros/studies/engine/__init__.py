# SPDX-License-Identifier: Apache-2.0
"""One engine for all studies: what is varied, who runs it, where the results go."""
