"""The maps under the worlds: one for all, or several with a run of worlds on each."""

from collections.abc import Iterator, Sequence

import numpy as np

from companion.arrays import Float32Array, FloatArray, IntArray
from companion.policy.observation import Layout, build_observation
from companion.world.maps import Map
from sim.sampling import sample_free
from sim.targets import TargetPaths, random_paths


class Terrain:
    """What ``num_worlds`` worlds ask of their maps.

    World ``i`` lies on map ``i * len(maps) // num_worlds``. The only loops run over maps.
    Arrays have one row for each entry of ``worlds``, which must ascend.

    Raises:
        ValueError: If there is no map, or more maps than worlds, or if the maps differ in
            size or edge.
    """

    def __init__(self, maps: Sequence[Map], num_worlds: int) -> None:
        if not 1 <= len(maps) <= num_worlds:
            raise ValueError(
                f"need at least one map and a world for each, "
                f"got {len(maps)} maps and {num_worlds} worlds"
            )
        first = maps[0]
        for other in maps[1:]:
            if other.edge_m != first.edge_m or not np.array_equal(other.size_m, first.size_m):
                raise ValueError(
                    f"maps {first.name} and {other.name} differ in size: {first.size_m} and "
                    f"{other.size_m} m; worlds stepped together must agree"
                )
        self.maps = tuple(maps)
        self.size_m = first.size_m
        self.edge_m = first.edge_m
        self.all_worlds: IntArray = np.arange(num_worlds)
        self._first_worlds = -(-np.arange(len(maps) + 1) * num_worlds // len(maps))
        self._all_parts = tuple(self._cut(self.all_worlds))

    def map_of(self, world: int) -> Map:
        """Return the map under one world."""
        return self.maps[int(np.searchsorted(self._first_worlds, world, side="right")) - 1]

    def crash_depth_m(self, start_enu_m: FloatArray, end_enu_m: FloatArray) -> FloatArray:
        """Return the length of every world's segment inside its obstacles, ``(N,)``."""
        depth_m = np.empty(len(start_enu_m))
        for city, rows in self._all_parts:
            depth_m[rows] = city.obstacles.crash_depth_m(start_enu_m[rows], end_enu_m[rows])
        return depth_m

    def observe(
        self,
        layout: Layout,
        worlds: IntArray,
        *,
        position_enu_m: FloatArray,
        velocity_enu_mps: FloatArray,
        target_enu_m: FloatArray,
    ) -> Float32Array:
        """Return the observations of ``worlds``, ``(len(worlds), n)``."""
        observation = np.empty((len(worlds), len(layout.fields)), dtype=np.float32)
        for city, rows in self._parts(worlds):
            observation[rows] = build_observation(
                layout,
                position_enu_m=position_enu_m[rows],
                velocity_enu_mps=velocity_enu_mps[rows],
                target_enu_m=target_enu_m[rows],
                map=city,
            )
        return observation

    def sample_free(self, worlds: IntArray, rng: np.random.Generator) -> FloatArray:
        """Return a free point for each of ``worlds``, ``(len(worlds), 3)``."""
        position_enu_m = np.empty((len(worlds), 3))
        for city, rows in self._parts(worlds):
            position_enu_m[rows] = sample_free(city, rng, rows.stop - rows.start)
        return position_enu_m

    def sample_paths(
        self, worlds: IntArray, rng: np.random.Generator, speed_mps: tuple[float, float]
    ) -> TargetPaths:
        """Return a trajectory clear of obstacles for each of ``worlds``."""
        paths = TargetPaths.unset(len(worlds))
        for city, rows in self._parts(worlds):
            count = rows.stop - rows.start
            paths.put(rows, random_paths(city, rng, count, speed_mps=speed_mps))
        return paths

    def _parts(self, worlds: IntArray) -> Sequence[tuple[Map, slice]]:
        if len(worlds) == len(self.all_worlds):
            return self._all_parts
        return tuple(self._cut(worlds))

    def _cut(self, worlds: IntArray) -> Iterator[tuple[Map, slice]]:
        """Yield each map that has some of ``worlds``, with their rows."""
        cuts = np.searchsorted(worlds, self._first_worlds).tolist()
        for city, start, stop in zip(self.maps, cuts[:-1], cuts[1:], strict=True):
            if start < stop:
                yield city, slice(start, stop)
