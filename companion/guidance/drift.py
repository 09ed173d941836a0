"""What carries the vehicle off: the part of its velocity that no command explains.

A vehicle takes up a command at once, as slowly as the shield was told, or anything between the
two. What none of these explains of its velocity is wind, a gust or an autopilot that leans the
wrong way. It is measured, never guessed: nothing of it is known before the vehicle has moved.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.guidance.braking import Braking

_BLUR_MPS = 0.2
"""So much is no drift: noise of the estimate, and commands that come late or not at all."""
_MOST_MPS = 3.0
"""A vehicle farther from all that was expected of it cannot follow, wherever it is sent; it is
expected from there on, lest the error grow for as long as it is pushed."""
_CALM_S = 15.0
"""Time constant with which a gust is forgotten."""


@dataclass(frozen=True, slots=True)
class Drift:
    """What the commands do not explain."""

    velocity_enu_mps: FloatArray
    """Now, on top of whatever is asked for, map ENU, ``(3,)``."""
    gust_mps: float
    """The strongest of late: it may come again, from anywhere."""

    def same_as(self, other: "Drift") -> bool:
        """Return whether both are the same, bit for bit."""
        mine, theirs = self.velocity_enu_mps, other.velocity_enu_mps
        return self.gust_mps == other.gust_mps and mine.tobytes() == theirs.tobytes()


CALM = Drift(np.zeros(3), 0.0)


class DriftObserver:
    """Watches one vehicle."""

    def __init__(self) -> None:
        self._slow_mps: FloatArray | None = None
        self._gust_mps = 0.0

    def update(
        self,
        velocity_enu_mps: FloatArray,
        sent_enu_mps: FloatArray | None,
        braking: Braking,
        *,
        dt_s: float,
    ) -> Drift:
        """Take a new velocity, and return what is unexplained of it.

        Args:
            velocity_enu_mps: Measured, shape ``(3,)``; nothing can be said if it is not finite.
            sent_enu_mps: What the vehicle was asked for since the last update, shape ``(3,)``;
                ``None`` if it followed somebody else, and nothing can be said.
            braking: Its slowest response.
            dt_s: Since the last update.
        """
        self._gust_mps *= math.exp(-dt_s / _CALM_S)
        if not all(map(math.isfinite, velocity_enu_mps.tolist())):
            self._slow_mps = None
            return Drift(np.zeros(3), self._gust_mps)
        if self._slow_mps is None or sent_enu_mps is None:
            self._slow_mps = velocity_enu_mps
            return Drift(np.zeros(3), self._gust_mps)
        error_mps = sent_enu_mps - self._slow_mps
        length_mps = math.sqrt(float(error_mps @ error_mps))
        share = 1.0 - math.exp(-dt_s / braking.lag_s)
        share = min(share, braking.brake_mps2 * dt_s / max(length_mps, 1e-9))
        self._slow_mps = self._slow_mps + share * error_mps

        # The nearest that is explained lies between the slowest vehicle and the command.
        way_mps, ahead_mps = (1.0 - share) * error_mps, velocity_enu_mps - self._slow_mps
        along = float(ahead_mps @ way_mps) / max(float(way_mps @ way_mps), 1e-9)
        drift_mps = ahead_mps - min(1.0, max(0.0, along)) * way_mps
        size_mps = math.sqrt(float(drift_mps @ drift_mps))
        if size_mps > _MOST_MPS:
            drift_mps = drift_mps * (_MOST_MPS / size_mps)
            size_mps = _MOST_MPS
            self._slow_mps = velocity_enu_mps - drift_mps
        clear_mps = max(0.0, size_mps - _BLUR_MPS)
        self._gust_mps = max(self._gust_mps, clear_mps)
        return Drift(drift_mps * (clear_mps / max(size_mps, 1e-9)), self._gust_mps)
