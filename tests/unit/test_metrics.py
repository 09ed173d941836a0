"""Figures of a run: right to the per cent, in memory that does not grow."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.reasons import Reason
from companion.guidance.situation import Outcome
from companion.metrics import Histogram, Metrics
from companion.session.summary import HISTOGRAM_EDGES_MS
from companion.vehicle import LinkStats


def summary(metrics):
    return metrics.summary(Outcome.ARRIVED, Reason.ARRIVED, "there", now_s=10.0, stats=LinkStats())


@given(st.lists(st.floats(0.01, 5000.0), min_size=1, max_size=200), st.sampled_from([50, 99]))
def test_percentiles_are_right_to_a_per_cent(durations_ms, percent):
    histogram = Histogram()
    for duration_ms in durations_ms:
        histogram.add(duration_ms)
    exact_ms = np.percentile(durations_ms, percent, method="inverted_cdf")
    assert histogram.percentile_ms(percent) == pytest.approx(exact_ms, rel=0.011)
    assert histogram.longest_ms == pytest.approx(max(durations_ms))
    assert sum(histogram.coarse(HISTOGRAM_EDGES_MS)) == len(durations_ms)


def test_nothing_measured_is_not_zero():
    found = summary(Metrics(start_s=0.0, rate_hz=20.0))
    assert found.latency_p50_ms is found.jitter_p99_ms is found.longest_gap_ms is None
    assert found.min_clearance_m is None
    assert sum(found.latency_histogram) == 0


def test_a_steady_stream_with_one_pause():
    metrics = Metrics(start_s=0.0, rate_hz=20.0)
    for tick in range(100):
        if tick == 50:
            metrics.withheld()
        metrics.sent(0.05 * tick + (20.0 if tick >= 50 else 0.0), 1.5)
    found = summary(metrics)
    assert found.setpoints_sent == 100
    assert found.setpoint_rate_hz == pytest.approx(20.0)
    assert found.longest_gap_ms == pytest.approx(50.0)
    assert found.jitter_p99_ms < 0.01
    assert found.latency_histogram[2] == 100  # 1 to 2 ms
    assert sum(found.jitter_histogram) == 98  # a pause of the stream is no jitter


def test_a_gap_in_a_stream_that_was_to_go_on_is_told_however_long():
    metrics = Metrics(start_s=0.0, rate_hz=50.0)
    for tick in range(100):
        metrics.sent(0.02 * tick + (3.0 if tick >= 50 else 0.0), 1.5)
    assert summary(metrics).longest_gap_ms == pytest.approx(3020.0)


def test_the_smallest_clearance_knows_its_place():
    metrics = Metrics(start_s=0.0, rate_hz=20.0)
    for clearance_m, east_m in ((5.0, 1.0), (2.0, 2.0), (np.nan, 3.0), (np.inf, 4.0), (3.0, 5.0)):
        metrics.cleared(clearance_m, np.array([east_m, 0.0, 0.0]))
    assert summary(metrics).min_clearance_m == 2.0
    assert metrics.closest_enu_m[0] == 2.0
