"""Whether the vehicle's local and global position mean the same place.

LOCAL_POSITION_NED plus the local origin must be where GLOBAL_POSITION_INT says. If it is not, the
origin has moved and we have not heard of it, or the estimator was reset between the two: then the
map lies elsewhere than we think (DESIGN 5.4).
"""

import math

import numpy as np

from companion.arrays import FloatArray
from companion.world.frames import GeoPoint, LocalTie

_TOGETHER_S = 0.3
"""Messages further apart than this are not compared; nearer, the velocity bridges the gap."""
_FRESH_S = 3.0
"""An older comparison says nothing of now."""
_PERIOD_S = 0.2
_ZERO = np.zeros(3)


class FrameCheck:
    """Compares the two positions whenever the global one comes."""

    def __init__(self, earth_radius_m: float) -> None:
        """Compare on the sphere on which the autopilot lays its local frame."""
        self._earth_radius_m = earth_radius_m
        self._tie: LocalTie | None = None
        self._residual_m: float | None = None
        self._compared_s = -math.inf

    def is_due(self, now_s: float) -> bool:
        """Return whether another comparison is worth its price."""
        return now_s - self._compared_s >= _PERIOD_S

    def forget(self) -> None:
        """Drop what was found: one of the two has begun anew."""
        self._residual_m = None
        self._compared_s = -math.inf

    def residual_m(self, now_s: float) -> float | None:
        """Return the newest distance between the two, ``None`` where none is known."""
        return self._residual_m if now_s - self._compared_s <= _FRESH_S else None

    def compare(
        self,
        global_point: GeoPoint,
        origin: GeoPoint,
        position_ned_m: FloatArray,
        velocity_ned_mps: FloatArray,
        *,
        global_after_local_s: float,
        now_s: float,
    ) -> None:
        """Take in a global position.

        Args:
            global_point: Of GLOBAL_POSITION_INT.
            origin: Of GPS_GLOBAL_ORIGIN.
            position_ned_m: Of LOCAL_POSITION_NED, shape ``(3,)``.
            velocity_ned_mps: The same, shape ``(3,)``.
            global_after_local_s: By the vehicle's clock.
            now_s: Arrival on our clock.
        """
        if abs(global_after_local_s) > _TOGETHER_S:
            return
        if self._tie is None or self._tie.local_origin != origin:
            self._tie = LocalTie.from_launch(_ZERO, origin, earth_radius_m=self._earth_radius_m)
        here_enu_m = self._tie.position_to_map(
            position_ned_m + velocity_ned_mps * global_after_local_s
        )
        there_enu_m = self._tie.geodetic_to_map(global_point)
        self._residual_m = float(np.linalg.norm(there_enu_m - here_enu_m))
        self._compared_s = now_s
