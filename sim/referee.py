"""The referee of one flight: where the vehicle was, and what it touched on the way."""

import numpy as np

from companion.arrays import FloatArray
from companion.world.maps import Map


class Referee:
    """Record a flight and judge it against the map.

    The judgement is worked out when it is asked for, over everything flown since, so that
    recording costs nothing in the loop.
    """

    def __init__(self, city: Map, start_enu_m: FloatArray) -> None:
        self._city = city
        self._trail_enu_m = [start_enu_m]
        self._judged = 0
        self._touching = False
        self._contacts = 0
        self._min_clearance_m = float(city.obstacles.signed_distance_m(start_enu_m))

    def record(self, position_enu_m: FloatArray) -> None:
        """Note that the vehicle flew straight from the last position to this one."""
        self._trail_enu_m.append(position_enu_m)

    @property
    def trail_enu_m(self) -> FloatArray:
        """Return every position, shape ``(T, 3)``."""
        return np.stack(self._trail_enu_m)

    @property
    def contacts(self) -> int:
        """Return how many times the vehicle went into an obstacle."""
        self._judge()
        return self._contacts

    @property
    def min_clearance_m(self) -> float:
        """Return the smallest distance from any obstacle; negative inside, else ``inf``."""
        self._judge()
        return self._min_clearance_m

    def _judge(self) -> None:
        fresh_enu_m = np.stack(self._trail_enu_m[self._judged :])
        self._judged = len(self._trail_enu_m) - 1
        if len(fresh_enu_m) < 2:
            return
        obstacles = self._city.obstacles
        touching = obstacles.crash_depth_m(fresh_enu_m[:-1], fresh_enu_m[1:]) > 0.0
        before = np.concatenate(([self._touching], touching[:-1]))
        self._contacts += int(np.count_nonzero(touching & ~before))
        self._touching = bool(touching[-1])
        clearance_m = obstacles.signed_distance_m(fresh_enu_m[1:])
        self._min_clearance_m = min(self._min_clearance_m, float(np.min(clearance_m)))
