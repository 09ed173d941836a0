"""The map around a vehicle: of a whole town, what a decision can depend on.

Rays, distances and the shield look no farther than a street or two. They are handed a map of the
same frame, size and name with only the obstacles near the vehicle in it, so that a step takes as
long over a city as over a block.
"""

from dataclasses import replace

import numpy as np

from companion.arrays import FloatArray
from companion.world.maps import Map

REACH_M = 170.0
"""Everything nearer than this is there: as far as the way round looks, and farther than rays do."""
STRIDE_M = 40.0
"""The piece is cut anew when the vehicle is farther than this from its middle."""


class Neighbourhood:
    """Cuts the map around one vehicle, again and again.

    Args:
        city: The whole map.
    """

    def __init__(self, city: Map) -> None:
        self._city = city
        self._piece: Map | None = None
        self._middle_m = np.full(2, np.inf)

    def around(self, position_enu_m: FloatArray) -> Map:
        """Return the map with the obstacles around a position ``(3,)``.

        All obstacles within ``REACH_M`` are there, so distances up to that are exact; beyond it
        they may seem longer. A map that is hardly larger comes back as it is.
        """
        half_m = REACH_M + STRIDE_M
        if np.all(self._city.size_m[:2] <= 2.0 * half_m):
            return self._city
        place_m = np.asarray(position_enu_m, dtype=np.float64)[:2]
        if not np.isfinite(place_m).all():
            return self._city if self._piece is None else self._piece
        if self._piece is None or np.abs(place_m - self._middle_m).max() > STRIDE_M:
            self._middle_m = place_m.copy()
            self._piece = _cut(self._city, place_m - half_m, place_m + half_m)
        return self._piece


def _cut(city: Map, low_m: FloatArray, high_m: FloatArray) -> Map:
    """Return a map with the obstacles only that reach into a box of the ground."""
    rows, obstacles = city.obstacles.near(low_m, high_m)
    return replace(
        city,
        obstacles=obstacles,
        footprints_m=tuple(city.footprints_m[row] for row in rows),
        heights_m=city.heights_m[rows],
        obstacle_names=tuple(city.obstacle_names[row] for row in rows),
    )
