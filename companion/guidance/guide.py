"""The way to the current target, found a little in every tick.

Until a way is found, and wherever there is none, the target straight ahead stands for it. What is
known at a tick depends on the ticks before it alone, never on how long they took: a replay finds
the same ways at the same ticks.
"""

from collections.abc import Iterator

import numpy as np

from companion.arrays import FloatArray
from companion.policy.observation import Layout
from companion.world.maps import Map
from companion.world.neighbourhood import Neighbourhood
from companion.world.way_ahead import WayAhead, Ways
from companion.world.ways import CELL_M, RENEW_M, WINDOW_CELLS, WayField, WayGrid, finish, through

PARTS_A_TICK = 2
"""Of one to three milliseconds each: a way is found within a second at 20 Hz, within two where the
window has to move first."""
_OFF_CENTER_M = 0.25 * WINDOW_CELLS * CELL_M
"""On a map larger than the window, the window moves when the vehicle is so far from its middle."""


class Guide:
    """Leads one vehicle.

    Args:
        city: The map. If it is no larger than the window, its cells are cut here, once.
        layout: What the actor sees; without a way in it there is nothing to do.
    """

    def __init__(self, city: Map, layout: Layout) -> None:
        self._city, self._needed = city, layout.shows_way
        self._surroundings = Neighbourhood(city)
        self._windowed = bool((city.size_m[:2] > WINDOW_CELLS * CELL_M).any())
        self._grid: WayGrid | None = None
        if self._needed and not self._windowed:
            self._grid = finish(WayGrid.build(city))
        self._ways: Ways | None = None
        self._made_for_enu_m: FloatArray | None = None
        self._work: Iterator[None] | None = None
        self.found = 0
        """How many ways were found; while it stays, the same question has the same answer."""

    def ahead(self, position_enu_m: FloatArray, target_enu_m: FloatArray) -> WayAhead | None:
        """Return the way ahead of the vehicle; ``None`` where the actor does not see it.

        Args:
            position_enu_m: Of the vehicle, shape ``(3,)``.
            target_enu_m: Shape ``(3,)``.
        """
        if not self._needed:
            return None
        made_for_m = self._made_for_enu_m
        if self._ways is None or made_for_m is None or _far(made_for_m, target_enu_m, 2 * RENEW_M):
            return WayAhead.straight(position_enu_m, target_enu_m)
        return self._ways.ahead_of_one(0, position_enu_m, target_enu_m)

    def work(self, position_enu_m: FloatArray, target_enu_m: FloatArray) -> None:
        """Do a tick's share of the work; for after the setpoint has left.

        Args:
            position_enu_m: Of the vehicle, shape ``(3,)``.
            target_enu_m: Shape ``(3,)``.
        """
        if not self._needed or not np.isfinite((position_enu_m, target_enu_m)).all():
            return
        if self._work is None and self._stale(position_enu_m, target_enu_m):
            self._work = self._find(position_enu_m.copy(), target_enu_m.copy())
        for _ in range(PARTS_A_TICK):
            if self._work is not None and next(self._work, self) is self:
                self._work = None

    def _stale(self, position_enu_m: FloatArray, target_enu_m: FloatArray) -> bool:
        made_for_m = self._made_for_enu_m
        if made_for_m is None or _far(made_for_m, target_enu_m, RENEW_M):
            return True
        return self._off_center(position_enu_m)

    def _off_center(self, position_enu_m: FloatArray) -> bool:
        """Return whether another window would have the vehicle nearer to its middle."""
        if not self._windowed or self._grid is None:
            return self._windowed
        middle_m = self._grid.low_m + 0.5 * CELL_M * np.array(self._grid.shape)
        off_m = position_enu_m - middle_m
        last_m = self._city.size_m - 0.5 * CELL_M * np.array(self._grid.shape)
        at_border = (middle_m <= 0.5 * CELL_M * np.array(self._grid.shape)) & (off_m < 0.0)
        at_border |= (middle_m >= last_m - CELL_M) & (off_m > 0.0)
        return bool(np.any((np.abs(off_m) > _OFF_CENTER_M)[:2] & ~at_border[:2]))

    def _find(self, position_enu_m: FloatArray, target_enu_m: FloatArray) -> Iterator[None]:
        grid = self._grid
        if grid is None or self._off_center(position_enu_m):
            here = self._surroundings.around(position_enu_m)
            grid = yield from through(WayGrid.build(here, position_enu_m))
        field = yield from through(WayField.spread(grid, target_enu_m))
        self._grid, self._made_for_enu_m = grid, target_enu_m
        self._ways = Ways([grid], np.zeros(1, dtype=np.int64))
        self._ways.put(0, field)
        self.found += 1


def _far(one_enu_m: FloatArray, other_enu_m: FloatArray, least_m: float) -> bool:
    return bool(np.square(one_enu_m - other_enu_m).sum() > least_m**2)
