# SPDX-License-Identifier: Apache-2.0
"""The manipulation controller: joint torques that hold and move the object."""
