# SPDX-License-Identifier: Apache-2.0
"""What nodes share: conversions, parameters, executor, middleware."""
