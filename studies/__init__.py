# SPDX-License-Identifier: Apache-2.0
"""Studies and campaigns; they import the package, and nothing imports them."""
