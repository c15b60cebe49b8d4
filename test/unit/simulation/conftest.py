# SPDX-License-Identifier: Apache-2.0
"""Which tests need a newer Python than the package does."""

import sys

collect_ignore = ["test_mujoco_plant.py"] if sys.version_info < (3, 11) else []
