# SPDX-License-Identifier: Apache-2.0
"""Show a run: one self-contained HTML page, figures and tables."""
