"""The way round: how far it is to a target from everywhere, through the streets and over the roofs.

A box of the map is cut into cells. A move goes from a cell to one of its 26 neighbours and costs
its length, more where it climbs or descends faster than autopilots do, and more near walls; no
move passes through an obstacle, however thin. From the cells that see the target the cost of the
remaining way spreads in sweeps over the box, plane by plane, until nothing changes (the fast
sweeping method). All work comes in parts of a few milliseconds, so that a control loop can do one
in each of its ticks, and the result does not depend on how the parts are spread.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.world.maps import Map
from companion.world.skyline import BESIDE, FAR, MARGINS_M, NEAR, Skyline

CELL_M = 2.5
WINDOW_CELLS = 64
"""Of a larger map only so many cells east and north are looked at: 160 m."""
RENEW_M = 4.0
"""A target that has moved no farther keeps its field: the last leg is flown by sight."""
HERE = 26
"""The move of a cell that sees the target, or of one from which there is no way."""
_NODES = 4
"""Nodes of the skyline on the edge of a cell."""
_SEES_CELLS = 2
"""Cells no farther from the target's than this may see it."""
_SHUT_FACTOR = 40.0
_NEAR_FACTOR = 8.0
_FAR_FACTOR = 1.5
"""How much farther a way seems in cells all of which lie within the shield's margin, in cells whose
centre does, and a little off it. The first are not flown through, as the shield forbids it, but
where a target or a vehicle stands there and nothing else leads to it or out; the second are
corners and narrow streets."""
_CLIMB = 5.0 / 3.0
"""Level speed over climb speed, and below over descent speed, as autopilots fly by default: what is
long is what takes long."""
_DESCENT = 5.0 / 1.5
_MOST_ROUNDS = 100
_PLANES_A_PART = 8
_MOVES_A_PART = 7

_T = TypeVar("_T")

MOVES: IntArray = np.array(
    [
        *((side, north, up) for side in (-1, 1) for north in (-1, 0, 1) for up in (-1, 0, 1)),
        *((0, side, up) for side in (-1, 1) for up in (-1, 0, 1)),
        *((0, 0, side) for side in (-1, 1)),
        (0, 0, 0),
    ]
)
"""East, north and up, in cells; the last is ``HERE``."""


def finish(work: Iterator[_T | None]) -> _T:
    """Do all parts of some work at once and return its result."""
    for result in work:
        if result is not None:
            return result
    raise RuntimeError("the work ended without a result")


def through(work: Iterator[_T | None]) -> Generator[None, None, _T]:
    """Pass on the parts of some work and return its result."""
    for result in work:
        if result is not None:
            return result
        yield None
    raise RuntimeError("the work ended without a result")


@dataclass(frozen=True, slots=True, eq=False)
class WayGrid:
    """The cells of a box of a map, and what the moves between them cost."""

    city: Map
    low_m: FloatArray  # (3,)
    """The box's lowest corner on the map."""
    shape: tuple[int, int, int]
    skyline: Skyline
    east_cost: Float32Array  # (2, X, 3, 3, Y, Z)
    """Of the moves west and east; then which of the nine, then the cell that is left."""
    north_cost: Float32Array  # (2, Y, 3, X, Z)
    """Of the moves south and north without a part east."""
    up_cost: Float32Array  # (2, Z, X, Y)
    """Straight down and up."""

    @classmethod
    def build(
        cls,
        city: Map,
        center_enu_m: FloatArray | None = None,
        *,
        window_cells: int = WINDOW_CELLS,
    ) -> Iterator["WayGrid | None"]:
        """Cut a map into cells, bit by bit.

        Args:
            city: The map.
            center_enu_m: Around which point, ``(3,)``, if the map is larger than the window.
            window_cells: Size of the window, east and north.

        Yields:
            ``None`` after each part of the work, at last the grid.
        """
        cells = np.ceil(city.size_m / CELL_M - 1e-9).astype(int)
        low_m = np.zeros(3)
        for axis in (0, 1):
            if cells[axis] > window_cells:
                center = cells[axis] // 2
                if center_enu_m is not None:
                    center = int(center_enu_m[axis] // CELL_M)
                first = min(max(center - window_cells // 2, 0), cells[axis] - window_cells)
                cells[axis], low_m[axis] = window_cells, first * CELL_M
        x, y, z = (int(count) for count in cells)
        nodes = (x * _NODES + 1, y * _NODES + 1)
        skyline = yield from through(Skyline.survey(city, low_m[:2], nodes, CELL_M / _NODES))

        height_m = (low_m[2] + CELL_M * (np.arange(z) + 0.5)).astype(np.float32)
        factor = np.ones((x, y, z), dtype=np.float32)
        for margin, price in ((FAR, _FAR_FACTOR), (NEAR, _NEAR_FACTOR)):
            center_m = skyline.height_m[margin, _NODES // 2 :: _NODES, _NODES // 2 :: _NODES]
            factor[height_m < center_m[..., None]] = price
            factor[..., height_m > city.size_m[2] - MARGINS_M[margin]] = price
        shut_m = _lowest_within_cells(skyline.height_m[NEAR])
        factor[height_m + 0.5 * CELL_M < shut_m[..., None]] = _SHUT_FACTOR
        factor[..., height_m - 0.5 * CELL_M > city.size_m[2] - MARGINS_M[NEAR]] = _SHUT_FACTOR
        yield None
        east_cost = np.empty((2, x, 3, 3, y, z), dtype=np.float32)
        north_cost = np.empty((2, y, 3, x, z), dtype=np.float32)
        up_cost = np.empty((2, z, x, y), dtype=np.float32)
        between_m = []
        for move in MOVES[:HERE]:
            between_m.append(_highest_between(skyline.height_m[BESIDE], (x, y), move)[..., None])
            if len(between_m) % _MOVES_A_PART == 0:
                yield None
        # Plane by plane, not move by move: new memory is dear to touch, and each page of it is
        # touched in one part only.
        for first in range(0, x, _PLANES_A_PART):
            part = slice(first, min(first + _PLANES_A_PART, x))
            for move, highest_m in zip(MOVES[:HERE], between_m, strict=True):
                lower_m = np.minimum(height_m, height_m + CELL_M * move[2])
                cost = np.float32(_length_m(CELL_M * move)) * factor[part]
                cost[lower_m < highest_m[part]] = np.inf
                east, north, up = (int(step) for step in move)
                if east:
                    east_cost[(east + 1) // 2, part, north + 1, up + 1] = cost
                elif north:
                    north_cost[(north + 1) // 2, :, up + 1, part] = np.moveaxis(cost, 1, 0)
                else:
                    up_cost[(up + 1) // 2, :, part] = np.moveaxis(cost, 2, 0)
            yield None
        yield cls(city, low_m, (x, y, z), skyline, east_cost, north_cost, up_cost)

    def cell_of(self, position_enu_m: FloatArray) -> IntArray:
        """Return the cells ``(..., 3)`` of positions, the nearest for those outside the box."""
        cell = np.floor((position_enu_m - self.low_m) / CELL_M).astype(np.int64)
        return np.clip(cell, 0, np.array(self.shape) - 1)

    def center_m(self, cell: IntArray) -> FloatArray:
        """Return the centres ``(..., 3)`` of cells."""
        return self.low_m + CELL_M * (cell + 0.5)

    def holds(self, position_enu_m: FloatArray) -> bool:
        """Return whether a point lies in the box or on its faces."""
        high_m = self.low_m + CELL_M * np.array(self.shape)
        return bool(np.all((position_enu_m >= self.low_m) & (position_enu_m <= high_m)))


@dataclass(frozen=True, slots=True, eq=False)
class WayField:
    """What is left of the way to one target from every cell of a grid."""

    target_enu_m: FloatArray  # (3,)
    cost_m: npt.NDArray[np.float16]  # (X, Y, Z)
    """Of the remaining way, in metres of level flight; infinite where there is none."""
    move: npt.NDArray[np.uint8]  # (X, Y, Z)
    """Which of ``MOVES`` comes next."""

    @classmethod
    def spread(cls, grid: WayGrid, target_enu_m: FloatArray) -> Iterator["WayField | None"]:
        """Let the cost spread from a target, bit by bit.

        A target outside the box is made for from the box's faces, as if the rest of the way were
        straight.

        Args:
            grid: The cells.
            target_enu_m: Shape ``(3,)``.

        Yields:
            ``None`` after each part of the work, at last the field.
        """
        x, y, z = grid.shape
        padded = np.full((x + 2, y + 2, z + 2), np.inf, dtype=np.float32)
        cost_m = padded[1:-1, 1:-1, 1:-1]
        seed_m = _seeds_m(grid, np.asarray(target_enu_m, dtype=np.float64))
        cost_m[...] = seed_m
        for _ in range(_MOST_ROUNDS):
            before = cost_m.copy()
            for side in (0, 1):
                _sweep_east(padded, grid.east_cost[side], side)
                yield None
            for side in (0, 1):
                _sweep_north(padded, grid.north_cost[side], side)
                _sweep_up(padded, grid.up_cost[side], side)
            yield None
            if np.array_equal(before, cost_m):
                break
        move = np.empty(grid.shape, dtype=np.uint8)
        for first in range(0, x, _PLANES_A_PART):
            part = slice(first, min(first + _PLANES_A_PART, x))
            move[part] = _best_moves(grid, padded, part)
            yield None
        move[cost_m >= seed_m] = HERE
        yield cls(np.array(target_enu_m, dtype=np.float64), cost_m.astype(np.float16), move)


def _length_m(way_m: FloatArray) -> float:
    """Return how long a straight way takes, as metres of level flight."""
    up_m = float(way_m[2])
    return max(float(np.linalg.norm(way_m)), _CLIMB * up_m, -_DESCENT * up_m)


def _lowest_within_cells(node_m: Float32Array) -> Float32Array:
    """Return the lowest node of the skyline in each cell or on its edge, ``(X, Y)``."""
    blocks = sliding_window_view(node_m, (_NODES + 1, _NODES + 1))[::_NODES, ::_NODES]
    lowest_m: Float32Array = blocks.min(axis=(2, 3))
    return lowest_m


def _highest_between(node_m: Float32Array, cells: tuple[int, int], move: IntArray) -> Float32Array:
    """Return the skyline along a move from each cell's centre, ``cells``.

    Its nodes on the way are so close that nothing the way meets is farther than the skyline's
    margin from one of them.
    """
    highest_m = np.full(cells, -np.inf, dtype=np.float32)
    for step in range(_NODES + 1):
        east, north = (
            np.clip(
                _NODES * np.arange(cells[axis]) + _NODES // 2 + step * move[axis],
                0,
                node_m.shape[axis] - 1,
            )
            for axis in (0, 1)
        )
        np.maximum(highest_m, node_m[np.ix_(east, north)], out=highest_m)
    return highest_m


def _seeds_m(grid: WayGrid, target_enu_m: FloatArray) -> Float32Array:
    """Return the straight ways to the target from cells that see it, infinite for the others."""
    seed_m = np.full(grid.shape, np.inf, dtype=np.float32)
    if grid.holds(target_enu_m):
        around = np.indices((2 * _SEES_CELLS + 1,) * 3).reshape(3, -1).T - _SEES_CELLS
        cell = grid.cell_of(target_enu_m) + around
        cell = cell[np.all((cell >= 0) & (cell < grid.shape), axis=1)]
    else:
        border = np.ones(grid.shape, dtype=np.bool_)
        border[1:-1, 1:-1] = False
        cell = np.argwhere(border)
        height_m = grid.skyline.height_m[BESIDE][tuple(cell[:, :2].T * _NODES + _NODES // 2)]
        cell = cell[grid.center_m(cell)[:, 2] >= height_m]
    center_m = grid.center_m(cell)
    way_m = target_enu_m - center_m
    length_m = np.sqrt(np.square(way_m).sum(axis=1))
    length_m = np.maximum(length_m, np.maximum(_CLIMB * way_m[:, 2], -_DESCENT * way_m[:, 2]))
    if grid.holds(target_enu_m):
        depth_m = grid.city.obstacles.crash_depth_m(center_m, target_enu_m)
        inside = grid.city.obstacles.contains(center_m)
        length_m[(depth_m > 0.0) | inside] = np.inf
    seed_m[tuple(cell.T)] = length_m
    return seed_m


def _sweep_east(padded: Float32Array, cost: Float32Array, side: int) -> None:
    x, y, z = (length - 2 for length in padded.shape)
    total = np.empty((3, 3, y, z), dtype=np.float32)
    nine, best = total.reshape(9, y, z), np.empty((y, z), dtype=np.float32)
    beside = sliding_window_view(padded, (y, z), axis=(1, 2))
    for plane in range(1, x + 1) if side == 0 else range(x, 0, -1):
        np.add(beside[plane + 2 * side - 1], cost[plane - 1], out=total)
        np.minimum.reduce(nine, axis=0, out=best)
        here = padded[plane, 1:-1, 1:-1]
        np.minimum(here, best, out=here)


def _sweep_north(padded: Float32Array, cost: Float32Array, side: int) -> None:
    _, y, z = (length - 2 for length in padded.shape)
    for plane in range(1, y + 1) if side == 0 else range(y, 0, -1):
        beside = padded[1:-1, plane + 2 * side - 1]
        here = padded[1:-1, plane, 1:-1]
        for up in range(3):
            np.minimum(here, beside[:, up : up + z] + cost[plane - 1, up], out=here)


def _sweep_up(padded: Float32Array, cost: Float32Array, side: int) -> None:
    z = padded.shape[2] - 2
    for plane in range(1, z + 1) if side == 0 else range(z, 0, -1):
        here = padded[1:-1, 1:-1, plane]
        beside = padded[1:-1, 1:-1, plane + 2 * side - 1]
        np.minimum(here, beside + cost[plane - 1], out=here)


def _best_moves(grid: WayGrid, padded: Float32Array, part: slice) -> npt.NDArray[np.uint8]:
    """Return the best move from each cell of some planes."""
    x, y, z = part.stop - part.start, *grid.shape[1:]
    best_m = np.full((x, y, z), np.inf, dtype=np.float32)
    best = np.full((x, y, z), HERE, dtype=np.uint8)
    for number, (east, north, up) in enumerate(MOVES[:HERE]):
        if number < 18:
            cost = grid.east_cost[number // 9, part, north + 1, up + 1]
        elif number < 24:
            cost = np.moveaxis(grid.north_cost[(number - 18) // 3, :, up + 1, part], 1, 0)
        else:
            cost = np.moveaxis(grid.up_cost[number - 24, :, part], 0, 2)
        total = (
            cost
            + padded[
                part.start + 1 + east : part.stop + 1 + east,
                1 + north : 1 + north + y,
                1 + up : 1 + up + z,
            ]
        )
        better: BoolArray = total < best_m
        np.minimum(best_m, total, out=best_m)
        best[better] = number
    return best
