# SPDX-License-Identifier: Apache-2.0
"""The orchestrator: start the nodes of a scenario, watch, command, stop and summarize."""
