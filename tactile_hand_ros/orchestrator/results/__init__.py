# SPDX-License-Identifier: Apache-2.0
"""What came of a run: read from its bag, judged, written and shown."""
