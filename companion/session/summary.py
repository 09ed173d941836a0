"""The summary of a run: one object for ``--json``, ``summary.json`` and the recording."""

import msgspec

HISTOGRAM_EDGES_MS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Upper edges of the bins of the histograms; one more bin holds what is beyond the last."""


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """How a run ended and what it measured; ``None`` where there was nothing to measure."""

    outcome: str
    """One word: arrived, stood_down, refused ..."""
    reason: str
    """For people: why it ended."""
    exit_code: int
    reason_code: str = ""
    """The same for scripts, one of ``companion.guidance.reasons``."""
    session_dir: str | None = None
    duration_s: float = 0.0
    distance_flown_m: float = 0.0
    final_distance_m: float | None = None
    """To the target."""
    min_clearance_m: float | None = None
    """From obstacles and ground, from the moment the vehicle obeys us until it is given back."""
    max_speed_mps: float | None = None
    v_max_mps: float | None = None
    """Speed cap of the flight; below ``--v-max`` where ``--cap-by-failsafe`` lowered it."""
    setpoints_sent: int = 0
    setpoint_rate_hz: float | None = None
    jitter_p99_ms: float | None = None
    """Of the interval between setpoints, around its nominal value."""
    longest_gap_ms: float | None = None
    """Between two setpoints of one stream."""
    latency_p50_ms: float | None = None
    """From the arrival of a position to the setpoint on the wire."""
    latency_p99_ms: float | None = None
    latency_histogram: list[int] = []
    """Setpoints by latency, bins as in ``HISTOGRAM_EDGES_MS``."""
    jitter_histogram: list[int] = []
    """Intervals by their deviation, the same bins."""
    late_ticks: int = 0
    shield_interventions: int = 0
    """Ticks in which the shield changed the velocity."""
    shield_reasons: dict[str, int] = {}
    """The same by reason, the most frequent first. ``speed limit`` is the autopilot's own way with
    a dive or a climb; the others are about the map."""
    setpoints_slowed: int = 0
    """Decided under a lowered speed cap, because something was not as in training."""
    velocity_lag_s: float | None = None
    """How slowly the vehicle followed, as measured in flight."""
    takeovers: int = 0
    link_loss_percent: float | None = None
