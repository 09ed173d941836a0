"""Figures of one run, collected tick by tick and summed up at the end."""

from collections.abc import Sequence

import numpy as np

from companion.arrays import FloatArray
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome
from companion.session.summary import Summary
from companion.vehicle import LinkStats

_MAX_STEP_M = 20.0
"""A larger step between two ticks is a move of the frame, not of the vehicle."""


class Metrics:
    """What a summary is made of."""

    def __init__(self, *, start_s: float, rate_hz: float) -> None:
        self._start_s = start_s
        self._period_s = 1.0 / rate_hz
        self._last_position: FloatArray | None = None
        self._sent_s: list[float] = []
        self._latency_ms: list[float] = []
        self._distance_flown_m = 0.0
        self._min_clearance_m: float | None = None
        self.closest_enu_m: FloatArray | None = None
        """Where the smallest clearance was."""
        self._max_speed_mps: float | None = None
        self.final_distance_m: float | None = None
        self.late_ticks = 0
        self.shield_interventions = 0
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
        self._sent_s.append(time_s)
        if latency_ms is not None:
            self._latency_ms.append(latency_ms)

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
        intervals_s = np.diff(self._sent_s)
        # A pause in the stream is a phase without setpoints, not jitter.
        steady_s = intervals_s[intervals_s < 10 * self._period_s]
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
            setpoints_sent=len(self._sent_s),
            setpoint_rate_hz=_rounded(1.0 / steady_s.mean() if steady_s.size else None),
            jitter_p99_ms=_percentile(1e3 * np.abs(steady_s - self._period_s), 99),
            latency_p50_ms=_percentile(self._latency_ms, 50),
            latency_p99_ms=_percentile(self._latency_ms, 99),
            late_ticks=self.late_ticks,
            shield_interventions=self.shield_interventions,
            takeovers=self.takeovers,
            link_loss_percent=_rounded(stats.loss_percent),
        )


def _rounded(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else round(float(value), digits)


def _percentile(values: FloatArray | Sequence[float], percent: float) -> float | None:
    return _rounded(float(np.percentile(values, percent))) if len(values) else None
