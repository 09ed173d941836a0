"""The ceiling of every table: a planner with full knowledge of the map, and tracking of its way.

The floor, flying straight at the target, is ``evaluate.fly_straight``.
"""

from collections.abc import Callable, Sequence

import numpy as np

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.policy.action import (
    bearing_to_target_rad,
    displacement_to_action,
    polar_to_target_rad,
)
from companion.world.maps import Map
from sim.world import CityWorld
from training.evaluate import maps_with_worlds

FindWays = Callable[[Map, FloatArray, FloatArray], Sequence[FloatArray]]
"""From a map, starts ``(N, 3)`` and targets ``(N, 3)`` to ways ``(K, 3)``, both ends included."""

_MOVED_M = 1e-6


class PlanAndTrack:
    """Plans the shortest way at the start of an episode and flies along it.

    Each step heads for the farthest point of the way that is in plain sight, so that corners of
    the planner's graph are cut where there is room. The way to a moving target grows by every
    place where the target was seen, and the last step heads for where it will be if it goes on as
    it did in the step before: steps at which a memoryless policy stays behind.

    One object flies one episode of the worlds it is first called with.
    """

    def __init__(self, find_ways: FindWays) -> None:
        self._find_ways = find_ways
        self._way_enu_m: FloatArray | None = None  # (N, K, 3)
        self._seen_m: FloatArray = np.empty((0, 3))
        self._cities: list[tuple[Map, IntArray]] = []

    def __call__(self, world: CityWorld, observation: Float32Array) -> FloatArray:
        """Return the actions of one step, ``(N, 3)``."""
        position_m, target_m = world.position_enu_m, world.target_enu_m
        if self._way_enu_m is None:
            self._cities = maps_with_worlds(world)
            self._way_enu_m, self._seen_m = self._plan(position_m, target_m), target_m
        elif np.abs(self._way_enu_m[:, -1] - target_m).max() > _MOVED_M:
            self._way_enu_m = np.concatenate((self._way_enu_m, target_m[:, None]), axis=1)
        goal_m = target_m + (target_m - self._seen_m)
        self._seen_m = target_m
        for city, rows in self._cities:
            known = _in_sight(city, position_m[rows], goal_m[rows])
            goal_m[rows[~known]] = target_m[rows[~known]]
            hidden = rows[~_in_sight(city, position_m[rows], goal_m[rows])]
            goal_m[hidden] = _farthest_in_sight(city, position_m[hidden], self._way_enu_m[hidden])
        return displacement_to_action(
            goal_m - position_m,
            world.scaling,
            world.edge_m,
            bearing_to_target_rad(position_m, world.aim_enu_m),
            polar_to_target_rad(position_m, world.aim_enu_m),
        )

    def _plan(self, start_m: FloatArray, target_m: FloatArray) -> FloatArray:
        """Return all ways, filled up with their targets to the same number of points."""
        ways: list[FloatArray] = [np.empty((0, 3))] * len(start_m)
        for city, rows in self._cities:
            found = self._find_ways(city, start_m[rows], target_m[rows])
            for row, way in zip(rows.tolist(), found, strict=True):
                ways[row] = way
        padded_m = np.repeat(target_m[:, None], max(len(way) for way in ways), axis=1)
        for row, way in enumerate(ways):
            padded_m[row, : len(way)] = way
        return padded_m


def _in_sight(city: Map, from_m: FloatArray, to_m: FloatArray) -> BoolArray:
    clear: BoolArray = city.obstacles.crash_depth_m(from_m, to_m) == 0.0
    return clear


def _farthest_in_sight(city: Map, position_m: FloatArray, way_m: FloatArray) -> FloatArray:
    """Return the last point of each way that can be seen; its end where none can."""
    seen = _in_sight(city, position_m[:, None], way_m)
    last = seen.shape[1] - 1 - np.argmax(seen[:, ::-1], axis=1)
    farthest_m: FloatArray = way_m[np.arange(len(way_m)), last]
    return farthest_m
