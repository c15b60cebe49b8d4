# SPDX-License-Identifier: Apache-2.0
"""Configuration: typed models of YAML files, hand files, and their locations."""
