"""Random points in the free space of a map: starts and targets."""

import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world.maps import Map

_ROUNDS = 200


def sample_free(
    city: Map, rng: np.random.Generator, count: int, *, margin_m: float = 0.0
) -> FloatArray:
    """Return points drawn uniformly from the map's box without its obstacles.

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
    found: list[FloatArray] = []
    missing = count
    for _ in range(_ROUNDS):
        # Half of the space free is the usual worst; the rest comes in another round.
        candidates = rng.uniform(0.0, city.size_m, (2 * missing + 8, 3))
        free = candidates[city.is_free(candidates, margin_m)][:missing]
        found.append(free)
        missing -= len(free)
        if missing == 0:
            return np.concatenate(found)
    raise MapError(f"map {city.name}: no free space found more than {margin_m:g} m from obstacles")
