"""The maps under the worlds: one for all, or several with a run of worlds on each."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
import shapely

from companion.arrays import FloatArray, IntArray
from companion.world.geometry import Obstacles
from companion.world.maps import Map
from sim.atlas import Atlas


class Terrain:
    """What lies under ``num_worlds`` worlds; they are spread evenly over the maps, in order.

    Raises:
        ValueError: If there is no map, or more maps than worlds, or if the maps differ in size.
    """

    def __init__(self, maps: Sequence[Map], num_worlds: int) -> None:
        if not 1 <= len(maps) <= num_worlds:
            raise ValueError(
                f"need at least one map and a world for each, "
                f"got {len(maps)} maps and {num_worlds} worlds"
            )
        first = maps[0]
        for other in maps[1:]:
            if not np.array_equal(other.size_m, first.size_m):
                raise ValueError(
                    f"maps {first.name} and {other.name} differ in size: {first.size_m} and "
                    f"{other.size_m} m; worlds stepped together must agree"
                )
        self.maps = tuple(maps)
        self.size_m: FloatArray = first.size_m
        self.edge_m = first.edge_m
        self.all_worlds: IntArray = np.arange(num_worlds)
        self.map_of_world: IntArray = self.all_worlds * len(maps) // num_worlds
        """Which of the maps lies under each world."""
        self._atlas = Atlas.under(maps, self.map_of_world) if len(maps) > 1 else None
        self.whole = self._over(self._atlas)
        """The map under all worlds: row ``i`` of a query to it belongs to world ``i``."""

    def grown(self, margin_m: float) -> "Terrain":
        """Return the same with every obstacle grown by ``margin_m`` to all sides and up."""
        return Terrain([_grown(city, margin_m) for city in self.maps], len(self.all_worlds))

    def map_of(self, world: int) -> Map:
        """Return the map under one world."""
        return self.maps[int(self.map_of_world[world])]

    def take(self, worlds: IntArray) -> "Terrain":
        """Return what lies under some of the worlds, in that order."""
        taken = copy(self)
        taken.all_worlds = np.arange(len(worlds))
        taken.map_of_world = self.map_of_world[worlds]
        taken._atlas = None if self._atlas is None else self._atlas.take(worlds)
        taken.whole = taken._over(taken._atlas)
        return taken

    def under(self, worlds: IntArray) -> Map:
        """Return the map under some worlds: row ``i`` of a query belongs to ``worlds[i]``."""
        return self.whole if self._atlas is None else self._over(self._atlas.take(worlds))

    def _over(self, atlas: Atlas | None) -> Map:
        if atlas is None:
            return self.maps[0]
        return replace(self.maps[0], name=f"one of {len(self.maps)} maps", obstacles=atlas)


def _grown(city: Map, margin_m: float) -> Map:
    outlines = shapely.buffer(
        [shapely.Polygon(footprint) for footprint in city.footprints_m],
        margin_m,
        join_style="mitre",
        mitre_limit=2.0,
    )
    # What closes around a courtyard has a hole; the vehicle has no business in there.
    footprints_m = tuple(
        np.asarray(shapely.remove_repeated_points(outline.exterior, 1e-6).coords)[:-1]
        for outline in outlines
    )
    heights_m = city.heights_m + margin_m
    return replace(
        city,
        footprints_m=footprints_m,
        heights_m=heights_m,
        obstacles=Obstacles(footprints_m, heights_m),
    )
