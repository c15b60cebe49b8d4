# SPDX-License-Identifier: Apache-2.0
"""Durations keep their percentiles, to the width of a bin, through text."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.histogram import Histogram, parse_histogram


@given(st.lists(st.floats(2e-6, 9.0), min_size=1, max_size=200))
def test_every_percentile_is_kept_to_a_twentieth(durations):
    histogram = Histogram()
    for duration in durations:
        histogram.note(duration)
    middles, counts = parse_histogram(histogram.text())
    found = np.repeat(middles, counts)
    np.testing.assert_allclose(found, np.sort(durations), rtol=0.06)
    assert (histogram.count, histogram.largest) == (len(durations), max(durations))


def test_what_is_too_short_or_too_long_is_counted_too():
    histogram = Histogram()
    for duration in (0.0, 1e-9, 1e4):
        histogram.note(duration)
    middles, counts = parse_histogram(histogram.text())
    assert counts.tolist() == [2, 1]
    assert middles[0] < 2e-6 and middles[1] > 5.0


def test_nothing_is_an_empty_text():
    assert Histogram().text() == ""
    middles, counts = parse_histogram("")
    assert not len(middles) and not len(counts)
