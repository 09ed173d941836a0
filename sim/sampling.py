"""Random points in the free space of maps: starts and targets."""

from collections.abc import Callable

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.errors import MapError
from companion.world.maps import Map

MapUnder = Callable[[IntArray], Map]
"""Returns the map under some rows; every row of a query to it belongs to one of them."""

_TRIES = 3
"""Candidates for each point at once: most points need no second round."""
_ROUNDS = 200


def sample_free(
    city: Map, rng: np.random.Generator, count: int, *, margin_m: float = 0.0
) -> FloatArray:
    """Return points drawn uniformly from a map's box without its obstacles.

    Args:
        city: The map.
        rng: Source of randomness.
        count: How many points.
        margin_m: Keep the points farther than this from every obstacle.

    Returns:
        ``position_enu_m``, shape ``(count, 3)``.

    Raises:
        MapError: If the map has next to no free space.
    """
    return sample_free_under(lambda _: city, rng, np.arange(count), margin_m=margin_m)


def sample_free_under(
    map_under: MapUnder, rng: np.random.Generator, rows: IntArray, *, margin_m: float = 0.0
) -> FloatArray:
    """Return a point for each of ``rows``, as ``sample_free`` does for one map."""
    position_enu_m = np.empty((len(rows), 3))
    missing: IntArray = np.arange(len(rows))
    for _ in range(_ROUNDS):
        if len(missing) == 0:
            return position_enu_m
        city = map_under(np.repeat(rows[missing], _TRIES))
        candidates = rng.uniform(0.0, city.size_m, (len(missing) * _TRIES, 3))
        free = _is_free(city, candidates, margin_m).reshape(-1, _TRIES)
        first = np.argmax(free, axis=1) + np.arange(len(missing)) * _TRIES
        found = np.any(free, axis=1)
        position_enu_m[missing[found]] = candidates[first[found]]
        missing = missing[~found]
    city = map_under(rows[missing])
    raise MapError(f"map {city.name}: no free space found more than {margin_m:g} m from obstacles")


def _is_free(city: Map, position_enu_m: FloatArray, margin_m: float) -> BoolArray:
    """Return which points of the box are free, ``(N,)``."""
    if margin_m > 0.0:
        return city.is_free(position_enu_m, margin_m)
    # The same for prisms, and much cheaper than distances.
    above: BoolArray = position_enu_m[:, 2] > city.obstacles.floor_m(position_enu_m)
    return above
