# SPDX-License-Identifier: Apache-2.0
"""Show a run: one self-contained page of HTML, figures and tables."""
