# SPDX-License-Identifier: Apache-2.0
"""`python -m tactile_hand_ros.cli`, the same as `tactile-hand`; the cockpit saves with it."""

import sys

from tactile_hand_ros.cli.app import main

sys.exit(main())
