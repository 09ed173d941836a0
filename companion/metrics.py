"""Figures of one run, collected tick by tick in constant memory and summed up at the end."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome
from companion.session.summary import HISTOGRAM_EDGES_MS, Summary
from companion.vehicle import LinkStats

_MAX_STEP_M = 20.0
"""A larger step between two ticks is a move of the frame, not of the vehicle."""


class Histogram:
    """Counts durations in bins 1 % wide, so that an hour takes no more room than a minute."""

    _LOW_MS, _HIGH_MS, _RATIO = 1e-3, 1e5, 1.01

    def __init__(self) -> None:
        self._low_log, self._step_log = np.log(self._LOW_MS), np.log(self._RATIO)
        num_bins = int((np.log(self._HIGH_MS) - self._low_log) / self._step_log) + 2
        self._counts = np.zeros(num_bins, dtype=np.int64)
        self.longest_ms: float | None = None

    def add(self, duration_ms: float) -> None:
        """Count one duration."""
        duration_ms = min(max(duration_ms, self._LOW_MS), self._HIGH_MS)
        self._counts[int((np.log(duration_ms) - self._low_log) / self._step_log)] += 1
        self.longest_ms = max(self.longest_ms or 0.0, duration_ms)

    def percentile_ms(self, percent: float) -> float | None:
        """Return the duration that ``percent`` of those counted do not exceed, to 1 %."""
        if self.longest_ms is None:
            return None
        rank = np.ceil(percent / 100.0 * self._counts.sum())
        reached = int(np.searchsorted(np.cumsum(self._counts), max(1.0, rank)))
        return min(float(self._upper_ms(reached)), self.longest_ms)

    def coarse(self, edges_ms: Sequence[float]) -> list[int]:
        """Return the counts up to each edge and beyond the last."""
        bins = np.searchsorted(edges_ms, self._upper_ms(np.arange(len(self._counts))))
        counted = np.bincount(bins, self._counts, len(edges_ms) + 1)
        return [int(count) for count in counted]

    def _upper_ms(self, number: npt.ArrayLike) -> FloatArray:
        upper_ms: FloatArray = np.exp(self._low_log + self._step_log * (np.asarray(number) + 1.0))
        return upper_ms


class Metrics:
    """What a summary is made of."""

    def __init__(self, *, start_s: float, rate_hz: float) -> None:
        self._start_s = start_s
        self._period_s = 1.0 / rate_hz
        self._last_position: FloatArray | None = None
        self._setpoints = 0
        self._sent_s: float | None = None
        self._steady_s, self._intervals = 0.0, 0
        self._latency, self._jitter = Histogram(), Histogram()
        self._longest_gap_ms: float | None = None
        self._distance_flown_m = 0.0
        self._min_clearance_m: float | None = None
        self.closest_enu_m: FloatArray | None = None
        """Where the smallest clearance was."""
        self._max_speed_mps: float | None = None
        self.final_distance_m: float | None = None
        self.late_ticks = 0
        self.shield_reasons: Counter[str] = Counter()
        """Interventions of the shield, by their reason."""
        self.setpoints_slowed = 0
        self.velocity_lag_s: float | None = None
        self.takeovers = 0

    def moved(self, position_enu_m: FloatArray, velocity_enu_mps: FloatArray) -> None:
        """Count one position of the vehicle in the air."""
        if self._last_position is not None:
            step_m = float(np.linalg.norm(position_enu_m - self._last_position))
            self._distance_flown_m += step_m if step_m < _MAX_STEP_M else 0.0
        self._last_position = position_enu_m
        self._max_speed_mps = max(
            self._max_speed_mps or 0.0, float(np.linalg.norm(velocity_enu_mps))
        )

    def cleared(self, clearance_m: float, position_enu_m: FloatArray) -> None:
        """Count the clearance of one tick in the air, while the vehicle is ours."""
        known = self._min_clearance_m
        if np.isfinite(clearance_m) and (known is None or clearance_m < known):
            self._min_clearance_m, self.closest_enu_m = clearance_m, position_enu_m

    def sent(self, time_s: float, latency_ms: float | None) -> None:
        """Count one setpoint."""
        self._setpoints += 1
        if self._sent_s is not None:
            interval_s = time_s - self._sent_s
            self._steady_s, self._intervals = self._steady_s + interval_s, self._intervals + 1
            self._jitter.add(1e3 * abs(interval_s - self._period_s))
            self._longest_gap_ms = max(self._longest_gap_ms or 0.0, 1e3 * interval_s)
        self._sent_s = time_s
        if latency_ms is not None:
            self._latency.add(latency_ms)

    def withheld(self) -> None:
        """Note a tick that was meant to send nothing: the stream has ended, or not begun."""
        self._sent_s = None

    def summary(
        self,
        outcome: Outcome,
        code: Reason,
        reason: str,
        *,
        now_s: float,
        stats: LinkStats,
    ) -> Summary:
        """Return the summary of the run, times in the units their names say."""
        return Summary(
            outcome=outcome,
            reason=reason,
            reason_code=code,
            exit_code=EXIT_CODES[outcome],
            duration_s=round(now_s - self._start_s, 3),
            distance_flown_m=round(self._distance_flown_m, 2),
            final_distance_m=_rounded(self.final_distance_m),
            min_clearance_m=_rounded(self._min_clearance_m),
            max_speed_mps=_rounded(self._max_speed_mps),
            setpoints_sent=self._setpoints,
            setpoint_rate_hz=_rounded(
                self._intervals / self._steady_s if self._steady_s > 0.0 else None
            ),
            jitter_p99_ms=_rounded(self._jitter.percentile_ms(99)),
            longest_gap_ms=_rounded(self._longest_gap_ms),
            latency_p50_ms=_rounded(self._latency.percentile_ms(50)),
            latency_p99_ms=_rounded(self._latency.percentile_ms(99)),
            latency_histogram=self._latency.coarse(HISTOGRAM_EDGES_MS),
            jitter_histogram=self._jitter.coarse(HISTOGRAM_EDGES_MS),
            late_ticks=self.late_ticks,
            shield_interventions=self.shield_reasons.total(),
            shield_reasons=dict(self.shield_reasons.most_common()),
            setpoints_slowed=self.setpoints_slowed,
            velocity_lag_s=_rounded(self.velocity_lag_s, 2),
            takeovers=self.takeovers,
            link_loss_percent=_rounded(stats.loss_percent),
        )


def _rounded(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else round(float(value), digits)
