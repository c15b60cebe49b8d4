# SPDX-License-Identifier: Apache-2.0
"""The report of a run, and of several runs side by side: one page of HTML that needs nothing."""

from tactile_hand_ros.analysis.report.page import COMPARISON, REPORT, write_comparison, write_report

__all__ = ["COMPARISON", "REPORT", "write_comparison", "write_report"]
