"""Which targets no vehicle that keeps a margin can come near to, whatever flies it.

Obstacles are prisms that stand on the ground, so from every free point the way straight up is free
to the top of the box. What a vehicle can reach is therefore known from above: columns that are open
at the top and hang together, each down to its lowest free point.
"""

import numpy as np
import shapely

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.maps import Map
from sim.world import CityWorld
from training.evaluate import maps_with_worlds

_CELL_M = 0.5
_INDULGENCE_M = 0.1
"""Off the margin, as a passage seldom runs through the middles of cells."""
_STARTS_M = 4.0
"""A start within the margin belongs to the nearest open column so near."""


def out_of_reach(world: CityWorld, *, margin_m: float, radius_m: float) -> BoolArray:
    """Return whose target has no reachable point within ``radius_m``, shape ``(N,)``.

    Args:
        world: As its cases begin, with targets at rest.
        margin_m: Kept from obstacles, from the ground and from all faces of the box.
        radius_m: How near is near enough.
    """
    start_enu_m, target_enu_m = world.position_enu_m, world.target_enu_m
    distance_m = np.empty(world.num_worlds)
    for city, rows in maps_with_worlds(world):
        columns = _Columns(city, margin_m - _INDULGENCE_M)
        for row in rows.tolist():
            distance_m[row] = columns.distance_m(start_enu_m[row], target_enu_m[row])
    return distance_m > radius_m


class _Columns:
    """The columns over a map's ground, seen from above."""

    def __init__(self, city: Map, margin_m: float) -> None:
        count = np.ceil(city.size_m[:2] / _CELL_M).astype(int)
        east_m, north_m = (_CELL_M * (np.arange(number) + 0.5) for number in count)
        ground_m = np.stack(np.meshgrid(east_m, north_m, indexing="ij"), axis=-1)
        self._top_m = float(city.size_m[2]) - margin_m
        lowest_m = _lowest_free_m(city, ground_m.reshape(-1, 2), margin_m)
        inside_m = np.minimum(ground_m, city.size_m[:2] - ground_m).min(axis=-1)
        is_open = (inside_m >= margin_m) & (lowest_m.reshape(count) <= self._top_m)
        self._part = _parts(is_open)[is_open]
        self._ground_m = ground_m[is_open]
        self._lowest_m = lowest_m.reshape(count)[is_open]

    def distance_m(self, start_enu_m: FloatArray, target_enu_m: FloatArray) -> float:
        """Return how near to a target a vehicle can come from a start; infinite if nowhere."""
        from_start_m = np.hypot(*(self._ground_m - start_enu_m[:2]).T)
        if len(from_start_m) == 0 or from_start_m.min() > _STARTS_M:
            return float("inf")
        mine = self._part == self._part[from_start_m.argmin()]
        beside_m = np.hypot(*(self._ground_m[mine] - target_enu_m[:2]).T)
        height_m = np.clip(target_enu_m[2], self._lowest_m[mine], self._top_m)
        return float(np.hypot(beside_m, height_m - target_enu_m[2]).min())


def _lowest_free_m(city: Map, ground_m: FloatArray, margin_m: float) -> FloatArray:
    """Return from which height on a vehicle over each point keeps the margin, ``(K,)``."""
    lowest_m = np.full(len(ground_m), margin_m)
    if len(city.footprints_m) == 0:
        return lowest_m
    outlines = np.array([shapely.Polygon(outline) for outline in city.footprints_m])
    points = shapely.points(ground_m)
    tree = shapely.STRtree(outlines)
    point, outline = tree.query(points, predicate="dwithin", distance=margin_m)
    beside_m = shapely.distance(points[point], outlines[outline])
    above_m = np.sqrt(np.maximum(margin_m**2 - np.square(beside_m), 0.0))
    np.maximum.at(lowest_m, point, city.heights_m[outline] + above_m)
    return lowest_m


def _parts(is_open: BoolArray) -> IntArray:
    """Return a number for every open cell, the same for cells that hang together; else -1."""
    part: IntArray = np.where(is_open, 0, -1)
    number = 0
    while (part == 0).any():
        number += 1
        part[_around(is_open, int(np.argmax(part == 0)))] = number
    return part


def _around(is_open: BoolArray, first: int) -> BoolArray:
    """Return which open cells hang together with one, given by its flat index.

    In sweeps over the plane, row by row and column by column, until nothing changes.
    """
    filled = np.zeros_like(is_open)
    filled.flat[first] = True
    while True:
        before = int(filled.sum())
        for cells, free in ((filled, is_open), (filled.T, is_open.T)):
            for row in range(1, len(cells)):
                cells[row] |= cells[row - 1] & free[row]
            for row in range(len(cells) - 2, -1, -1):
                cells[row] |= cells[row + 1] & free[row]
        if int(filled.sum()) == before:
            return filled
