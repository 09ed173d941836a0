"""Target tracks: where the target is, how old that is, and how far it may be trusted.

Positions are in the map frame (ENU, metres). A report that says nothing new (the sender
repeats itself) does not make a track younger. Sources, tiers and limits follow what PX4's
Follow-me and ArduPilot's AP_Follow do with the same messages.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from companion.arrays import FloatArray

FRESH_S = 0.5
"""Younger than this is fresh; slower senders get 1.5 of their own period."""
COAST_S = 1.5
"""So long a track goes on with its last velocity; after that it stays where it is."""
LOST_S = 3.0
"""Both autopilots give a silent target up after 3 s."""
MAX_SPEED_MPS = 30.0
"""A jump that implies more than this is not a movement."""
JUMP_TOLERANCE_M = 3.0
"""Position noise that two reports may differ by, however quickly they follow each other."""
JUMP_REPORTS = 3
"""So many reports in a row that agree with each other re-start a track at the new place."""


class TargetTier(StrEnum):
    """How far a track may be trusted."""

    NONE = "none"
    """No target was ever heard."""
    FRESH = "fresh"
    COAST = "coast"
    """Extrapolated with the last velocity."""
    HOLD = "hold"
    """Too old to extrapolate: the vehicle stops."""
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class TargetEstimate:
    """What a track says at one instant."""

    tier: TargetTier
    position_enu_m: FloatArray | None
    """Shape ``(3,)``; ``None`` only in tier NONE."""
    velocity_enu_mps: FloatArray
    """Shape ``(3,)``; zero for static and stopped targets."""
    age_s: float
    """Since the newest report that said something new; 0 for a static target."""


class TargetTrack:
    """One target, static or reported again and again.

    Time is an argument. Reports that jump are held back until ``JUMP_REPORTS`` of them agree;
    the count of rejected ones is kept for the log.
    """

    def __init__(self, static_position_enu_m: FloatArray | None = None) -> None:
        self._static = static_position_enu_m is not None
        self._position = static_position_enu_m
        self._velocity: FloatArray = np.zeros(3)
        self._time_s = 0.0
        self._period_s = FRESH_S / 1.5
        self._content: tuple[float, ...] | None = None
        self._jumps: list[tuple[float, FloatArray]] = []
        self.num_rejected = 0

    def set_static(self, position_enu_m: FloatArray) -> None:
        """Replace whatever was tracked by a point that does not move."""
        self._static = True
        self._position = position_enu_m
        self._velocity = np.zeros(3)
        self._jumps.clear()

    def forget(self) -> None:
        """Drop the track; the map has moved under it."""
        if not self._static:
            self._position = None
            self._content = None
            self._jumps.clear()

    def report(
        self,
        position_enu_m: FloatArray,
        velocity_enu_mps: FloatArray | None,
        *,
        time_s: float,
        source_time_s: float | None = None,
    ) -> None:
        """Take in one report.

        Args:
            position_enu_m: Shape ``(3,)``.
            velocity_enu_mps: Shape ``(3,)``; ``None`` where the source gives none: it is then
                taken from the last two positions.
            time_s: Arrival on our clock.
            source_time_s: The sender's clock, to tell a repeat from a target that stands still.
        """
        if self._static:
            return
        content = (*position_enu_m.tolist(), -1.0 if source_time_s is None else source_time_s)
        if content == self._content:
            return
        if not np.isfinite(position_enu_m).all():
            self.num_rejected += 1
            return
        self._content = content
        if self._position is not None and self._is_jump(self._position, position_enu_m, time_s):
            self.num_rejected += 1
            if not self._jump_confirmed(position_enu_m, time_s):
                return
            self._position = None
        self._jumps.clear()

        if velocity_enu_mps is not None and np.isfinite(velocity_enu_mps).all():
            velocity = velocity_enu_mps
        elif self._position is not None and time_s - self._time_s > 0.05:
            velocity = (position_enu_m - self._position) / (time_s - self._time_s)
        else:
            velocity = np.zeros(3)
        speed_mps = float(np.linalg.norm(velocity))
        if speed_mps > MAX_SPEED_MPS:
            velocity = velocity * (MAX_SPEED_MPS / speed_mps)
        if self._position is not None:
            period_s = min(time_s - self._time_s, LOST_S)
            self._period_s += 0.2 * (period_s - self._period_s)
        self._position, self._velocity, self._time_s = position_enu_m, velocity, time_s

    def estimate(self, now_s: float) -> TargetEstimate:
        """Return where the target is at ``now_s`` and how far that can be trusted."""
        if self._position is None:
            return TargetEstimate(TargetTier.NONE, None, np.zeros(3), np.inf)
        if self._static:
            return TargetEstimate(TargetTier.FRESH, self._position, self._velocity, 0.0)
        age_s = max(0.0, now_s - self._time_s)
        coasted = self._position + self._velocity * min(age_s, COAST_S)
        if age_s <= max(FRESH_S, min(1.5 * self._period_s, COAST_S)):
            return TargetEstimate(TargetTier.FRESH, coasted, self._velocity, age_s)
        if age_s <= COAST_S:
            return TargetEstimate(TargetTier.COAST, coasted, self._velocity, age_s)
        tier = TargetTier.HOLD if age_s <= LOST_S else TargetTier.LOST
        return TargetEstimate(tier, coasted, np.zeros(3), age_s)

    def _is_jump(self, last_enu_m: FloatArray, new_enu_m: FloatArray, time_s: float) -> bool:
        reach_m = JUMP_TOLERANCE_M + MAX_SPEED_MPS * max(0.0, time_s - self._time_s)
        return float(np.linalg.norm(new_enu_m - last_enu_m)) > reach_m

    def _jump_confirmed(self, position_enu_m: FloatArray, time_s: float) -> bool:
        """Return whether the newest reports agree on a new place."""
        self._jumps = [
            (t, p)
            for t, p in self._jumps
            if np.linalg.norm(position_enu_m - p) <= JUMP_TOLERANCE_M + MAX_SPEED_MPS * (time_s - t)
        ]
        self._jumps.append((time_s, position_enu_m))
        return len(self._jumps) >= JUMP_REPORTS
