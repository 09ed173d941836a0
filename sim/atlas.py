"""Several maps under one batch: row ``i`` of every query meets the obstacles of its own map.

It makes worlds on many maps nearly as fast as worlds on one: no loop runs over the maps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.geometry import Obstacles
from companion.world.maps import Map
from companion.world.pieces import ConvexPieces


@dataclass(frozen=True, slots=True, eq=False)
class RowPieces(ConvexPieces):
    """The pieces of all maps, and for every row of a batch a list of those it can meet.

    The bounds, ``low_x_m`` to ``high_y_m``, are here those of the listed pieces, ``(P, N)``.
    Where a list is shorter than the longest, ``low_x_m`` is infinite: nothing comes near that.
    """

    listed: IntArray  # (P, N)
    listed_roof_m: FloatArray  # (P, N)

    @classmethod
    def under(cls, maps: Sequence[Map], map_of_row: IntArray) -> "RowPieces":
        """List for every row the pieces of the map it lies on."""
        counts = [len(ConvexPieces.of(city.footprints_m, city.heights_m)) for city in maps]
        pieces = ConvexPieces.of(
            [footprint for city in maps for footprint in city.footprints_m],
            np.concatenate([city.heights_m for city in maps]),
        )
        slot = np.arange(max(counts))[:, None]
        filled = (slot < counts)[:, map_of_row]
        first = np.cumsum([0, *counts[:-1]])
        # The unfilled slots hold a piece beyond the last.
        listed = np.where(filled, (first + slot)[:, map_of_row], len(pieces))
        low_x_m, high_x_m, low_y_m, high_y_m, roof_m = (
            np.append(bound, np.inf)[listed]
            for bound in (
                pieces.low_x_m,
                pieces.high_x_m,
                pieces.low_y_m,
                pieces.high_y_m,
                pieces.roof_m,
            )
        )
        return cls(
            normal_x=pieces.normal_x,
            normal_y=pieces.normal_y,
            offset_m=pieces.offset_m,
            roof_m=pieces.roof_m,
            low_x_m=low_x_m,
            high_x_m=high_x_m,
            low_y_m=low_y_m,
            high_y_m=high_y_m,
            center_m=pieces.center_m,
            radius_m=pieces.radius_m,
            listed=listed,
            listed_roof_m=roof_m,
        )

    def __len__(self) -> int:
        return len(self.listed)

    def rows(self, rows: slice | IntArray) -> "RowPieces":
        """Return the lists of some rows."""
        return replace(
            self,
            low_x_m=self.low_x_m[:, rows],
            high_x_m=self.high_x_m[:, rows],
            low_y_m=self.low_y_m[:, rows],
            high_y_m=self.high_y_m[:, rows],
            listed=self.listed[:, rows],
            listed_roof_m=self.listed_roof_m[:, rows],
        )

    def _near(self, low_m: FloatArray, high_m: FloatArray) -> tuple[IntArray, IntArray]:
        overlap: BoolArray = self.low_x_m <= high_m[0]
        overlap &= self.high_x_m >= low_m[0]
        overlap &= self.low_y_m <= high_m[1]
        overlap &= self.high_y_m >= low_m[1]
        overlap &= self.listed_roof_m >= low_m[2]
        slot, row = np.nonzero(overlap)
        return self.listed[slot, row], row


class Atlas(Obstacles):
    """The obstacles under ``N`` rows that lie on several maps.

    Every query takes exactly ``N`` rows, ``(N, 3)``, and answers each as the ``Obstacles`` of its
    map do.
    """

    _pieces: RowPieces

    def __init__(self, maps: Sequence[Map], pieces: RowPieces, map_of_row: IntArray) -> None:
        self._maps = maps
        self._pieces = pieces
        self._map_of_row = map_of_row

    @classmethod
    def under(cls, maps: Sequence[Map], map_of_row: IntArray) -> "Atlas":
        """Lay ``maps`` under rows.

        Args:
            maps: The maps.
            map_of_row: Which of them each row lies on, shape ``(N,)``.
        """
        return cls(tuple(maps), RowPieces.under(maps, map_of_row), map_of_row)

    def take(self, rows: IntArray) -> "Atlas":
        """Return the atlas under some of the rows, in that order."""
        return Atlas(self._maps, self._pieces.rows(rows), self._map_of_row[rows])

    def __len__(self) -> int:
        return sum(len(city.obstacles) for city in self._maps)

    def signed_distance_m(self, position_enu_m: FloatArray) -> FloatArray:
        """Return what ``Obstacles.signed_distance_m`` does, with a loop over the maps."""
        signed_m = np.empty(len(position_enu_m))
        for number, rows in self._rows_of_maps():
            obstacles = self._maps[number].obstacles
            signed_m[rows] = obstacles.signed_distance_m(position_enu_m[rows])
        return signed_m

    def nearest_surface(self, position_enu_m: FloatArray) -> FloatArray:
        """Return what ``Obstacles.nearest_surface`` does, with a loop over the maps."""
        nearest_m = np.empty_like(position_enu_m)
        for number, rows in self._rows_of_maps():
            nearest_m[rows] = self._maps[number].obstacles.nearest_surface(position_enu_m[rows])
        return nearest_m

    def _rows_of_maps(self) -> list[tuple[int, BoolArray]]:
        present = np.unique(self._map_of_row).tolist()
        return [(number, self._map_of_row == number) for number in present]
