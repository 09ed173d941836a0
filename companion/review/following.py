"""How well the vehicle followed the velocities it was given."""

from collections.abc import Sequence

import numpy as np

from companion.arrays import FloatArray
from companion.session.records import Tick

_LONGEST_LAG_S = 2.0
_FEWEST = 30  # ticks
_ASKED_MPS = 0.5
_DEAF_SHARE = 0.3
_DEAF_S = 3.0


def following_facts(ticks: Sequence[Tick], period_s: float) -> list[tuple[str, str]]:
    """Return lag and error of the measured velocity against the one sent."""
    sent, measured = _pairs(ticks)
    if np.isfinite(sent).all(axis=-1).sum() < _FEWEST:
        return []
    best = (np.inf, 0)
    for shift in range(round(_LONGEST_LAG_S / period_s)):
        error = measured[shift:] - sent[: len(sent) - shift]
        mean = float(np.nanmean(np.linalg.norm(error, axis=-1)))
        best = min(best, (mean, shift))
    error_mps = float(np.nanmean(np.linalg.norm(measured - sent, axis=-1)))
    facts = [("Velocity error", f"{error_mps:.2f} m/s on average")]
    lag_s = best[1] * period_s
    if 0.0 < lag_s < _LONGEST_LAG_S - 2 * period_s and best[0] < 0.8 * error_mps:
        facts.append(("Velocity lag", f"{lag_s:.1f} s ({best[0]:.2f} m/s remain)"))
    return facts


def deaf_times(ticks: Sequence[Tick]) -> list[tuple[float, float]]:
    """Return from when to when the vehicle flew on setpoints and did not follow them."""
    sent, measured = _pairs(ticks)
    speed = np.linalg.norm(sent, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (sent * measured).sum(axis=-1) / np.square(speed)
        deaf = (speed > _ASKED_MPS) & (share < _DEAF_SHARE)
    found: list[tuple[float, float]] = []
    began: float | None = None
    for tick, is_deaf in zip(ticks, deaf, strict=True):
        if is_deaf:
            began = tick.time_s if began is None else began
        elif began is not None:
            if tick.time_s - began >= _DEAF_S:
                found.append((began, tick.time_s))
            began = None
    if began is not None and ticks[-1].time_s - began >= _DEAF_S:
        found.append((began, ticks[-1].time_s))
    return found


def _pairs(ticks: Sequence[Tick]) -> tuple[FloatArray, FloatArray]:
    """Return velocities sent and measured, ``(N, 3)`` each; NaN where setpoints do not fly."""
    nothing = [np.nan] * 3
    flown = [
        (tick.safe_enu_mps, tick.velocity_enu_mps)
        if tick.armed
        and tick.mode in ("OFFBOARD", "GUIDED")
        and tick.safe_enu_mps is not None
        and tick.velocity_enu_mps is not None
        else (nothing, nothing)
        for tick in ticks
    ]
    pairs = np.array(flown, dtype=np.float64).reshape(-1, 2, 3)
    return pairs[:, 0], pairs[:, 1]
