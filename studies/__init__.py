# SPDX-License-Identifier: Apache-2.0
"""Studies and campaigns; the package does not import them."""
