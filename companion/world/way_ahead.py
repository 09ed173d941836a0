"""What a vehicle needs to know of its way: the farthest point of it in sight, and what is left.

``Ways.ahead`` answers for thousands of vehicles at once: rows lie on grids of one shape, each with
a field of its own. ``Ways.ahead_of_one`` says the same of one vehicle, to the last bit, in a third
of the time: the control loop asks it between position and setpoint.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.skyline import BESIDE, NEAR
from companion.world.ways import CELL_M, HERE, MOVES, WayField, WayGrid

LOOKS: IntArray = np.array((1, 2, 3, 4, 6, 8, 11, 16))
"""After so many moves each the way is looked at; the last that is in sight is the aim."""
BEYOND_LOOKS = 2
"""So many looks farther lies the point that says where the way turns then."""
_SAMPLES = 16
"""Points of a line of sight."""
_ENDS_M = 0.75
"""Vehicle, target and centres of cells may stand close to a wall."""
_CLOSE_M = 4.0
_MOST_AIMS = 200
_BEYOND_M = 1e5
"""No map reaches as far."""
_AROUND = MOVES[:HERE]
_SHARE = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES).astype(np.float32)[:, None, None]
_END_SHARE = np.minimum(_SHARE, 1.0 - _SHARE)
_KNOWN: BoolArray = np.array(True)
_LOOK_AT: tuple[bool, ...] = tuple(step in LOOKS for step in range(int(LOOKS[-1]) + 1))


@dataclass(frozen=True, slots=True)
class WayAhead:
    """Of each vehicle; arrays of shape ``(..., 3)`` and ``(...)``."""

    aim_enu_m: FloatArray
    """The farthest point of the way in sight: the target itself where that is."""
    beyond_enu_m: FloatArray
    """A point of the way some moves behind the aim."""
    left_m: FloatArray
    """What is left of the way, in metres of level flight."""
    known: BoolArray
    """Whether there is a way; else aim and beyond are the target, and what is left is straight."""

    @classmethod
    def straight(cls, position_enu_m: FloatArray, target_enu_m: FloatArray) -> "WayAhead":
        """Return what is said where no way is known."""
        way_m = target_enu_m - position_enu_m
        aim_enu_m = np.broadcast_to(target_enu_m, way_m.shape)
        unknown = np.zeros(way_m.shape[:-1], dtype=np.bool_)
        return cls(aim_enu_m, aim_enu_m, np.sqrt(np.square(way_m).sum(axis=-1)), unknown)

    def take(self, rows: IntArray | int) -> "WayAhead":
        """Return some of the rows, or one as it is alone."""
        return WayAhead(*(getattr(self, f.name)[rows] for f in fields(self)))

    def with_rows(self, rows: IntArray, other: "WayAhead") -> "WayAhead":
        """Return a copy in which some rows are those of another."""
        columns = [getattr(self, f.name).copy() for f in fields(self)]
        for column, f in zip(columns, fields(self), strict=True):
            column[rows] = getattr(other, f.name)
        return WayAhead(*columns)


class Ways:
    """Fields over grids of one shape, laid end to end for batches; at first none is known.

    Args:
        grids: All of one shape and one lowest corner.
        grid_of_field: On which of them each field lies, shape ``(F,)``.
    """

    def __init__(self, grids: Sequence[WayGrid], grid_of_field: IntArray) -> None:
        first = grids[0]
        self._low_m, self._shape = first.low_m, np.array(first.shape)
        self._cells = int(np.prod(first.shape))
        self._stride = np.array((first.shape[1] * first.shape[2], first.shape[2], 1))
        self._axes: list[tuple[float, int, int]] = list(
            zip(self._low_m.tolist(), first.shape, self._stride.tolist(), strict=True)
        )
        """Lowest corner (m), cells, and cells from one to the next, of east, north and up."""
        self._jump = MOVES @ self._stride
        self._jump_of: list[int] = self._jump.tolist()
        self._nodes = first.skyline.height_m.shape[1:]
        self._last_node = np.array(self._nodes, dtype=np.float32)[:, None, None] - 1.0
        self._spacing_m = first.skyline.spacing_m
        self._skyline_m = np.concatenate(
            [grid.skyline.height_m[margin].ravel() for margin in (BESIDE, NEAR) for grid in grids]
        )
        self._margin_stride = len(self._skyline_m) // 2
        self._grid_of_field = grid_of_field
        entries = len(grid_of_field) * self._cells
        self._cost_m: npt.NDArray[np.float16] = np.full(entries, np.inf, dtype=np.float16)
        self._move: npt.NDArray[np.uint8] = np.full(entries, HERE, dtype=np.uint8)

    def put(self, number: int, field: WayField) -> None:
        """Make a field known, or replace it."""
        entries = slice(number * self._cells, (number + 1) * self._cells)
        self._cost_m[entries] = field.cost_m.ravel()
        self._move[entries] = field.move.ravel()

    def ahead(
        self, field: IntArray, position_enu_m: FloatArray, target_enu_m: FloatArray
    ) -> WayAhead:
        """Return the way ahead of vehicles.

        Args:
            field: Which field leads each of them, shape ``(N,)``.
            position_enu_m: Shape ``(N, 3)``.
            target_enu_m: Where the target is now, ``(N, 3)``; a few metres from the field's at
                most.

        Positions that are not finite get some answer, and no error.
        """
        position_enu_m = np.where(np.isfinite(position_enu_m), position_enu_m, 0.0)
        np.clip(position_enu_m, -_BEYOND_M, _BEYOND_M, out=position_enu_m)
        node = self._grid_of_field[field] * (self._nodes[0] * self._nodes[1])
        entry = field * self._cells
        cell = self._cell_of(position_enu_m)
        known = np.isfinite(self._cost_m[entry + cell])
        if not known.all():
            lost = np.flatnonzero(~known)
            cell[lost] = self._step_out(node[lost], entry[lost], cell[lost], position_enu_m[lost])
            known[lost] = np.isfinite(self._cost_m[entry[lost] + cell[lost]])

        chain, arrived = self._follow(entry, cell, target_enu_m)
        point_m = np.where(arrived[..., None], target_enu_m, self._center_m(chain))
        rows = np.arange(len(cell))
        seen = self._sees(node, position_enu_m, point_m)
        # The first is taken for granted: it is the next cell, or the target beside it.
        last = np.where(seen, np.arange(len(LOOKS))[:, None], 0).max(axis=0)
        beyond = np.minimum(last + BEYOND_LOOKS, len(LOOKS) - 1)
        aim_m = point_m[last, rows]
        left_m = _length_m(aim_m - position_enu_m)
        left_m += np.where(arrived[last, rows], 0.0, self._cost_m[entry + chain[last, rows]])
        straight = WayAhead.straight(position_enu_m, target_enu_m)
        return WayAhead(
            np.where(known[:, None], aim_m, target_enu_m),
            np.where(known[:, None], point_m[beyond, rows], target_enu_m),
            np.where(known, left_m, straight.left_m),
            known,
        )

    def ahead_of_one(
        self, field: int, position_enu_m: FloatArray, target_enu_m: FloatArray
    ) -> WayAhead:
        """Return what ``ahead`` says of one vehicle.

        Args:
            field: Which field leads it.
            position_enu_m: Shape ``(3,)``.
            target_enu_m: Shape ``(3,)``.
        """
        entry, position_m = field * self._cells, position_enu_m.tolist()
        number = -1
        if all(abs(m) < _BEYOND_M for m in position_m):
            number = entry + self._cell_of_one(position_m)
        if number < 0 or not math.isfinite(self._cost_m.item(number)):
            rows = np.array([field])
            return self.ahead(rows, position_enu_m[None], target_enu_m[None]).take(0)

        chain, arrived = self._follow_one(number)
        inside = all(
            low_m <= m <= low_m + CELL_M * cells
            for m, (low_m, cells, _) in zip(target_enu_m.tolist(), self._axes, strict=True)
        )
        arrived = [inside and there for there in arrived]
        point_m = np.array([self._center_of_one(number - entry) for number in chain])
        point_m[arrived] = target_enu_m
        node = self._grid_of_field.item(field) * (self._nodes[0] * self._nodes[1])
        seen = self._sees_from_one(node, position_enu_m, point_m).tolist()
        last = max((look for look, in_sight in enumerate(seen) if in_sight), default=0)
        aim_m, beyond = point_m[last], min(last + BEYOND_LOOKS, len(LOOKS) - 1)
        rest_m = 0.0 if arrived[last] else self._cost_m.item(chain[last])
        left_m = _length_m(aim_m - position_enu_m) + rest_m
        return WayAhead(aim_m, point_m[beyond], left_m, _KNOWN)

    def length_m(
        self, field: IntArray, position_enu_m: FloatArray, target_enu_m: FloatArray
    ) -> FloatArray:
        """Return how long the ways are when they are flown from aim to aim, shape ``(N,)``.

        Hardly longer than the shortest there are: what a planner can promise. Infinite where no
        way is known.
        """
        length_m = np.zeros(len(field))
        rows: IntArray = np.arange(len(field))
        here_m = np.array(position_enu_m, dtype=np.float64)
        for _ in range(_MOST_AIMS):
            ahead = self.ahead(field[rows], here_m[rows], target_enu_m[rows])
            length_m[rows] += _length_m(ahead.aim_enu_m - here_m[rows])
            length_m[rows[~ahead.known]] = np.inf
            here_m[rows] = ahead.aim_enu_m
            there = np.all(ahead.aim_enu_m == target_enu_m[rows], axis=1)
            rows = rows[~there]
            if len(rows) == 0:
                return length_m
        length_m[rows] = np.inf
        return length_m

    def _cell_of(self, position_enu_m: FloatArray) -> IntArray:
        cell = np.floor((position_enu_m - self._low_m) / CELL_M).astype(np.int64)
        number: IntArray = np.clip(cell, 0, self._shape - 1) @ self._stride
        return number

    def _cell_of_one(self, position_enu_m: list[float]) -> int:
        cell = 0
        for m, (low_m, cells, stride) in zip(position_enu_m, self._axes, strict=True):
            index = math.floor((m - low_m) / CELL_M)
            cell += min(max(index, 0), cells - 1) * stride
        return cell

    def _center_of_one(self, cell: int) -> list[float]:
        center_m = []
        for low_m, _, stride in self._axes:
            index, cell = divmod(cell, stride)
            center_m.append(low_m + CELL_M * (index + 0.5))
        return center_m

    def _center_m(self, cell: IntArray) -> FloatArray:
        """Return the centres ``(..., 3)`` of cells given by their numbers."""
        east, rest = np.divmod(cell, self._stride[0])
        north, up = np.divmod(rest, self._stride[1])
        center_m = np.empty((*cell.shape, 3))
        for axis, index in enumerate((east, north, up)):
            center_m[..., axis] = self._low_m[axis] + CELL_M * (index + 0.5)
        return center_m

    def _follow(
        self, entry: IntArray, cell: IntArray, target_enu_m: FloatArray
    ) -> tuple[IntArray, BoolArray]:
        """Return the cells at the looks along the ways, and whether the target comes before.

        The move after the last cell leads to the target, if that lies in the box.
        """
        high_m = self._low_m + CELL_M * self._shape
        inside = np.all((target_enu_m >= self._low_m) & (target_enu_m <= high_m), axis=1)
        chain = np.empty((len(LOOKS), len(cell)), dtype=np.int64)
        arrived = np.empty(chain.shape, dtype=np.bool_)
        number = entry + cell
        look = 0
        for step in range(1, int(LOOKS[-1]) + 1):
            move = self._move[number]
            number = number + self._jump[move]
            if _LOOK_AT[step]:
                chain[look] = number
                arrived[look] = move == HERE
                look += 1
        return chain - entry, arrived & inside

    def _follow_one(self, number: int) -> tuple[list[int], list[bool]]:
        """Return the entries at the looks along a way, and whether its field ends before."""
        chain, arrived = [], []
        for step in range(1, len(_LOOK_AT)):
            move = self._move.item(number)
            number += self._jump_of[move]
            if _LOOK_AT[step]:
                chain.append(number)
                arrived.append(move == HERE)
        return chain, arrived

    def _sees(self, node: IntArray, from_enu_m: FloatArray, to_enu_m: FloatArray) -> BoolArray:
        """Return which straight ways keep clear of the skyline, ``(K, N)``.

        Args:
            node: Where each row's skyline begins, ``(N,)``.
            from_enu_m: Shape ``(N, 3)``.
            to_enu_m: Shape ``(K, N, 3)``.
        """
        way_m = (to_enu_m - from_enu_m).astype(np.float32)
        # The ends lie close to walls often enough, and are looked at with more indulgence.
        end_m = _END_SHARE * _length_m(way_m)
        index = np.broadcast_to(node.astype(np.int32), end_m.shape)
        for axis, stride in ((0, self._nodes[1]), (1, 1)):
            from_nodes = (from_enu_m[:, axis] - self._low_m[axis]) / self._spacing_m + 0.5
            along = from_nodes.astype(np.float32) + _SHARE * (
                way_m[..., axis] * np.float32(1.0 / self._spacing_m)
            )
            np.clip(along, 0, self._nodes[axis] - 1, out=along)
            index = index + along.astype(np.int32) * np.int32(stride)
        height_m = from_enu_m[:, 2].astype(np.float32) + _SHARE * way_m[..., 2]
        margin = (end_m >= _CLOSE_M) * np.int32(self._margin_stride)
        skyline_m = self._skyline_m[index + margin]
        clear: BoolArray = np.all((height_m >= skyline_m) | (end_m < _ENDS_M), axis=0)
        return clear

    def _sees_from_one(self, node: int, from_enu_m: FloatArray, to_enu_m: FloatArray) -> BoolArray:
        """Return which straight ways from one place keep clear of the skyline, ``(K,)``.

        Args:
            node: Where its skyline begins.
            from_enu_m: Shape ``(3,)``.
            to_enu_m: Shape ``(K, 3)``.
        """
        way_m = (to_enu_m - from_enu_m).astype(np.float32)
        end_m = _END_SHARE[..., 0] * _length_m(way_m)
        from_nodes = ((from_enu_m[:2] - self._low_m[:2]) / self._spacing_m + 0.5).astype(np.float32)
        along = from_nodes[:, None, None] + _SHARE[..., 0] * (
            way_m.T[:2, None] * np.float32(1.0 / self._spacing_m)
        )
        np.minimum(np.maximum(along, 0.0, out=along), self._last_node, out=along)
        north, east = along.astype(np.int32)[::-1]
        index = east * self._nodes[1] + north + node
        height_m = from_enu_m[2].astype(np.float32) + _SHARE[..., 0] * way_m[:, 2]
        skyline_m = self._skyline_m[index + (end_m >= _CLOSE_M) * self._margin_stride]
        clear: BoolArray = ((height_m >= skyline_m) | (end_m < _ENDS_M)).all(axis=0)
        return clear

    def _step_out(
        self, node: IntArray, entry: IntArray, cell: IntArray, position_enu_m: FloatArray
    ) -> IntArray:
        """Return the best cell around a vehicle whose own has no way, its own if none has."""
        east, rest = np.divmod(cell, self._stride[0])
        north, up = np.divmod(rest, self._stride[1])
        around = np.stack((east, north, up), axis=-1) + _AROUND[:, None]
        inside = np.all((around >= 0) & (around < self._shape), axis=-1)
        number = np.where(inside, around @ self._stride, cell)
        center_m = self._center_m(number)
        way_m = self._cost_m[entry + number] + _length_m(center_m - position_enu_m)
        seen = self._sees(node, position_enu_m, center_m)
        # Through a wall only where there is nothing else.
        best = np.argmin(np.where(seen, way_m, way_m + 1e3), axis=0)
        stepped: IntArray = number[best, np.arange(len(cell))]
        return stepped


def _length_m(way_m: npt.NDArray[np.floating]) -> FloatArray:
    length_m: FloatArray = np.sqrt((way_m * way_m).sum(axis=-1))
    return length_m
