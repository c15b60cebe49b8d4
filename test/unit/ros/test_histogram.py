# SPDX-License-Identifier: Apache-2.0
"""Durations keep their percentiles, to the width of a bin, through text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.ros.histogram import Histogram, parse_histogram, percentiles


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


@pytest.mark.parametrize("count", [1, 2, 3, 4, 101, 151])
def test_percentiles_are_the_nearest_of_the_values(count):
    values = np.random.default_rng(count).permutation(count) + 0.5
    last = count - 1
    expected = {"p50": last // 2 + 0.5, "p99": round(0.99 * last) + 0.5, "max": last + 0.5}
    assert percentiles(values) == expected


def test_bins_are_a_24th_of_a_decade_from_a_microsecond_to_ten_seconds():
    histogram = Histogram()
    edge = 1e-6 * 10 ** (1 / 24)
    for duration in (1e-6, 0.999 * edge, 1.001 * edge, 9.999, 10.001, 1e3):
        histogram.note(duration)
    middles, counts = parse_histogram(histogram.text())
    assert counts.tolist() == [2, 1, 3] and histogram.largest == 1e3
    expected = [1e-6 * 10 ** (0.5 / 24), 1e-6 * 10 ** (1.5 / 24), 10 * 10 ** (-0.5 / 24)]
    np.testing.assert_allclose(middles, expected, rtol=1e-3)
