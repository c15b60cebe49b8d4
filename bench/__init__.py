# SPDX-License-Identifier: Apache-2.0
"""Speed benchmarks; the package does not import them."""
