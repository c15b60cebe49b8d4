# SPDX-License-Identifier: Apache-2.0
"""The number of inputs with which tests attack readers."""

from hypothesis import HealthCheck, settings

_CHECKS = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
_SHORT = settings(derandomize=True, database=None, max_examples=50)


def hostile(examples: int = 50) -> settings:
    """Return how many inputs are tried; `--hypothesis-profile fuzz` tries many random ones."""
    is_short = settings.default.max_examples <= 100
    base = settings(_SHORT, max_examples=examples) if is_short else settings.default
    return settings(base, deadline=None, suppress_health_check=_CHECKS)
