# SPDX-License-Identifier: Apache-2.0
"""Scenarios: typed YAML files that describe a run, and the checks before it starts."""
