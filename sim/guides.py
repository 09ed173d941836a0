"""Which way leads each of ``N`` vehicles to its target.

Where training draws its targets from a pool, the ways are found once and a step only reads them.
Elsewhere every world has a way of its own, found anew when its target has moved.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray, IntArray
from companion.world.maps import Map
from companion.world.way_ahead import WayAhead, Ways
from companion.world.ways import RENEW_M, WayField, WayGrid, finish
from sim.sampling import sample_free

_WINDOW_CELLS = 400
"""No window that moves with a vehicle: all of a map of 1 km."""
_MOST_FIELDS = 2_000
"""Kept for another evaluation of the same cases: 192 kB each on the paper's cube."""


class Surveyor:
    """Finds ways and remembers them."""

    def __init__(self) -> None:
        self._grids: dict[str, WayGrid] = {}
        self._fields: dict[tuple[str, bytes], WayField] = {}

    def grid(self, city: Map) -> WayGrid:
        """Return the cells of a map."""
        key = city.content_hash
        if key not in self._grids:
            self._grids[key] = finish(WayGrid.build(city, window_cells=_WINDOW_CELLS))
        return self._grids[key]

    def field(self, city: Map, target_enu_m: FloatArray) -> WayField:
        """Return the ways to a target."""
        key = (city.content_hash, target_enu_m.tobytes())
        if key not in self._fields:
            if len(self._fields) >= _MOST_FIELDS:
                del self._fields[next(iter(self._fields))]
            self._fields[key] = finish(WayField.spread(self.grid(city), target_enu_m))
        return self._fields[key]


class Guides:
    """The ways of ``N`` worlds.

    Args:
        maps: The maps under the worlds.
        map_of_world: Which of them each lies on, shape ``(N,)``.
        rng: Draws the pool.
        targets_per_map: Size of the pool; ``None`` for a way of its own for every world.
        surveyor: Shared, where the same cases are flown several times.
    """

    def __init__(
        self,
        maps: Sequence[Map],
        map_of_world: IntArray,
        rng: np.random.Generator,
        *,
        targets_per_map: int | None = None,
        surveyor: Surveyor | None = None,
    ) -> None:
        self._maps, self._map_of_world = maps, map_of_world
        self._surveyor = Surveyor() if surveyor is None else surveyor
        grids = [self._surveyor.grid(city) for city in maps]
        self.field_of_world: IntArray = np.arange(len(map_of_world))
        """Which way leads each world."""
        self.led_to_enu_m: FloatArray = np.full((len(map_of_world), 3), np.inf)
        """The targets that the ways were found for."""
        if targets_per_map is None:
            self.pool_enu_m: FloatArray | None = None
            self._ways = Ways(grids, map_of_world)
            return
        self.pool_enu_m = np.stack([sample_free(city, rng, targets_per_map) for city in maps])
        self._ways = Ways(grids, np.repeat(np.arange(len(maps)), targets_per_map))
        for number, target_enu_m in enumerate(self.pool_enu_m.reshape(-1, 3)):
            grid = grids[number // targets_per_map]
            self._ways.put(number, finish(WayField.spread(grid, target_enu_m)))

    def take(self, worlds: IntArray) -> "Guides":
        """Return the guides of some worlds."""
        taken = copy(self)
        taken._map_of_world = self._map_of_world[worlds]
        taken.field_of_world = self.field_of_world[worlds]
        taken.led_to_enu_m = self.led_to_enu_m[worlds]
        return taken

    def draw(self, worlds: IntArray, rng: np.random.Generator) -> FloatArray:
        """Return a target from the pool for some worlds, ``(K, 3)``, and lead them there.

        Raises:
            ValueError: If there is no pool.
        """
        if self.pool_enu_m is None:
            raise ValueError("there is no pool of targets to draw from")
        chosen = rng.integers(self.pool_enu_m.shape[1], size=len(worlds))
        self.field_of_world[worlds] = self._map_of_world[worlds] * self.pool_enu_m.shape[1] + chosen
        return self.pool_enu_m[self._map_of_world[worlds], chosen]

    def follow(self, target_enu_m: FloatArray) -> None:
        """Find new ways to the targets ``(N, 3)`` that are no longer where their ways lead."""
        if self.pool_enu_m is not None:
            return
        moved_m = target_enu_m - self.led_to_enu_m
        for world in np.flatnonzero(~(np.square(moved_m).sum(axis=1) <= RENEW_M**2)):
            self._lead(int(world), target_enu_m[world])

    def lead(self, worlds: IntArray, target_enu_m: FloatArray) -> None:
        """Find the ways to new targets ``(K, 3)`` of some worlds."""
        for world, position_enu_m in zip(worlds.tolist(), target_enu_m, strict=True):
            self._lead(world, position_enu_m)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what changes, to be saved and written into; then call ``restore``."""
        if self.pool_enu_m is None:
            return {"led_to_enu_m": self.led_to_enu_m}
        return {"field_of_world": self.field_of_world}

    def restore(self) -> None:
        """Find the ways that ``arrays`` tell of."""
        if self.pool_enu_m is None:
            self.lead(np.arange(len(self.led_to_enu_m)), self.led_to_enu_m.copy())

    def ahead(
        self, position_enu_m: FloatArray, target_enu_m: FloatArray, worlds: IntArray | None = None
    ) -> WayAhead:
        """Return the way ahead of all worlds, or of some."""
        fields = self.field_of_world if worlds is None else self.field_of_world[worlds]
        return self._ways.ahead(fields, position_enu_m, target_enu_m)

    def _lead(self, world: int, target_enu_m: FloatArray) -> None:
        city = self._maps[int(self._map_of_world[world])]
        field = self._surveyor.field(city, target_enu_m)
        self._ways.put(int(self.field_of_world[world]), field)
        self.led_to_enu_m[world] = target_enu_m
