# SPDX-License-Identifier: Apache-2.0
"""The messages of one tick: joined by stamp, skipped when late, watched for silence."""
