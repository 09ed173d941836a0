"""Where a run trains, is validated and is tested: one map, or random cities kept apart."""

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from companion.errors import UsageError
from companion.world.maps import Map, load_map
from sim.cities import CitySplit, CityStyle, random_city

VALIDATION_CITIES = 50
TEST_CITIES = 100
TRAINING_DENSITIES = (0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.5, 0.0)
"""Share of built-up blocks, in turn: an actor that has only seen dense cities hovers in the
open (91 % of the free map's cases instead of all). Validation and test cities are dense."""


@dataclass(frozen=True, slots=True)
class Place:
    """One map by name or file, or a number of random cities."""

    map: str | None = None
    cities: int | None = None

    def __post_init__(self) -> None:
        if (self.map is None) == (self.cities is None):
            raise UsageError("need one of --map and --cities")
        if self.cities is not None and self.cities < 1:
            raise UsageError(f"--cities must be at least 1, got {self.cities}")

    @property
    def label(self) -> str:
        """Return the place as the command line names it."""
        return f"--map {self.map}" if self.map is not None else f"--cities {self.cities}"

    def training_maps(self) -> tuple[Map, ...]:
        """Return the maps to train on."""
        if self.cities is None:
            return self._maps(CitySplit.TRAINING, None)
        turn = itertools.islice(itertools.cycle(TRAINING_DENSITIES), self.cities)
        return tuple(
            random_city(CitySplit.TRAINING, number, CityStyle(density=density))
            for number, density in enumerate(turn)
        )

    def validation_maps(self) -> tuple[Map, ...]:
        """Return the maps that choose the checkpoint: the same one map, or other cities."""
        return self._maps(CitySplit.VALIDATION, VALIDATION_CITIES)

    def test_maps(self) -> tuple[Map, ...]:
        """Return the maps to test on: the same one map, or cities never seen before.

        The number of test cities is ``cities``: ``training evaluate --cities N``.
        """
        return self._maps(CitySplit.TEST, self.cities)

    def _maps(self, split: CitySplit, count: int | None) -> tuple[Map, ...]:
        if self.map is not None:
            return (load_map(self.map),)
        return tuple(random_city(split, number) for number in range(count or 0))


def content_hash(maps: Sequence[Map]) -> str:
    """Return one hash of what the maps hold; that of the map itself where there is one."""
    if len(maps) == 1:
        return maps[0].content_hash
    return hashlib.sha256("".join(city.content_hash for city in maps).encode()).hexdigest()
