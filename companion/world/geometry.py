"""Obstacles: vertical prisms with simple footprints, and the questions one asks of them.

Obstacles are closed sets: a point on a wall or on a roof belongs to them, and a segment that
slides along a wall is inside for all of its way. They stand on the ground and reach below it
without end, so there is no bottom face to come near from. On slanted walls rounding decides
within about 1e-13 m; on walls along x or y, and on roofs, the border is exact.

Every method takes ``(3,)``, ``(N, 3)`` or any other leading shape and treats every row alone.
Positions must be finite: a nan makes depth and distance nan, and is unseen by the rays.
"""

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np
import numpy.typing as npt

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.pieces import ConvexPieces

_CHUNK = 2**15
"""Numbers in a work array: with 256 KiB each, the few in use stay in the cache."""
_FEW = 2**10
"""Corners times points up to which it is quicker to look at all of them."""
_ROUNDING_M = 1e-6
"""By far more than bounds of distances may be wrong by."""


class Obstacles:
    """A set of prisms, packed for batches.

    Args:
        footprints_m: Simple polygons, convex or not, either orientation, not closed, each of
            shape ``(V, 2)``.
        heights_m: Height of each roof, shape ``(O,)``.
    """

    def __init__(self, footprints_m: Sequence[FloatArray], heights_m: npt.ArrayLike) -> None:
        self._heights_m = np.array(heights_m, dtype=np.float64).reshape(-1, 1)
        self._pieces = ConvexPieces.of(footprints_m, self._heights_m[:, 0])
        num_corners = max((len(footprint) for footprint in footprints_m), default=1)
        # Short outlines are filled up with their first corner: edges without length.
        corner_m = np.zeros((num_corners, len(footprints_m), 2))
        for number, footprint in enumerate(footprints_m):
            corner_m[:, number] = footprint[0]
            corner_m[: len(footprint), number] = footprint
        self._next_corner = np.roll(np.arange(num_corners), -1)
        edge_m = corner_m[self._next_corner] - corner_m
        self._corner_m = np.ascontiguousarray(np.moveaxis(corner_m, -1, 0))  # (2, V, O)
        self._edge_m = np.ascontiguousarray(np.moveaxis(edge_m, -1, 0))  # (2, V, O)
        square_m2 = self._edge_m[0] ** 2 + self._edge_m[1] ** 2
        self._inverse_square = 1.0 / np.where(square_m2 > 0.0, square_m2, np.inf)
        self._low_m = self._corner_m.min(axis=1)[..., None]  # (2, O, 1)
        self._high_m = self._corner_m.max(axis=1)[..., None]  # (2, O, 1)

    def __len__(self) -> int:
        return len(self._heights_m)

    def near(self, low_m: FloatArray, high_m: FloatArray) -> tuple[IntArray, "Obstacles"]:
        """Return which obstacles reach into a box of the ground, and these alone.

        Of those that also reach out of it, what lies outside may be left out.

        Args:
            low_m: South-west corner, shape ``(2,)``.
            high_m: North-east corner, shape ``(2,)``.
        """
        inside = (high_m >= self._low_m[..., 0].T) & (low_m <= self._high_m[..., 0].T)
        rows = np.flatnonzero(inside.all(axis=1))
        few = copy(self)
        few._heights_m = self._heights_m[rows]
        few._pieces = self._pieces.near(low_m, high_m)
        # No more corners than theirs: beyond, all edges are without length.
        edges = np.flatnonzero(self._inverse_square[:, rows].any(axis=1))
        corners = int(edges.max(initial=0)) + 1
        few._next_corner = np.roll(np.arange(corners), -1)
        few._corner_m = self._corner_m[:, :corners, rows]
        few._edge_m = self._edge_m[:, :corners, rows]
        few._inverse_square = self._inverse_square[:corners, rows]
        few._low_m, few._high_m = self._low_m[:, rows], self._high_m[:, rows]
        return rows, few

    def crash_depth_m(self, start_enu_m: FloatArray, end_enu_m: FloatArray) -> FloatArray:
        """Return how much of each straight way lies inside the union of the obstacles.

        The paper's sigma in metres. Overlaps count once. A move without length has no depth,
        wherever it is.

        Args:
            start_enu_m: Shape ``(..., 3)``.
            end_enu_m: Shape ``(..., 3)``; the two are broadcast against each other.

        Returns:
            Shape ``(...)``, between 0 and the length of the way.
        """
        start_m, end_m = np.broadcast_arrays(_rows(start_enu_m), _rows(end_enu_m))
        start_m, end_m, shape = _flat(start_m), _flat(end_m), start_m.shape[:-1]
        length_m = np.sqrt(np.square(end_m - start_m).sum(axis=0))
        covered = np.zeros_like(length_m)
        for part in _parts(len(length_m), len(self._pieces)):
            pieces = self._pieces.rows(part)
            covered[part] = pieces.covered(start_m[:, part], end_m[:, part])
        depth_m: FloatArray = covered * length_m
        return depth_m.reshape(shape)

    def signed_distance_m(self, position_enu_m: FloatArray) -> FloatArray:
        """Return the distance to the nearest wall, edge or roof, negative inside, ``(...)``.

        Exact in three dimensions outside. Inside it is the distance to the surface of the obstacle
        one is deepest in, so where obstacles overlap the way out may be longer. ``inf`` without
        obstacles.
        """
        position_m = _rows(position_enu_m)
        flat_m = _flat(position_m)
        signed_m = np.full(flat_m.shape[1], np.inf)
        if len(self) > 0:
            for part in _parts(len(signed_m), len(self)):
                signed_m[part] = self._signed_distance(flat_m[:, part])
        return signed_m.reshape(position_m.shape[:-1])

    def nearest_surface(self, position_enu_m: FloatArray) -> FloatArray:
        """Return the surface point that ``signed_distance_m`` measures to, shape ``(..., 3)``.

        On inner walls of overlapping obstacles it may lie inside a neighbour. ``inf`` without
        obstacles.
        """
        position_m = _rows(position_enu_m)
        flat_m = _flat(position_m)
        nearest_m = np.full_like(flat_m, np.inf)
        if len(self) > 0:
            for part in _parts(flat_m.shape[1], len(self)):
                nearest_m[:, part] = self._nearest(flat_m[:, part])
        return np.ascontiguousarray(nearest_m.T).reshape(position_m.shape)

    def contains(self, position_enu_m: FloatArray) -> BoolArray:
        """Return whether points lie inside an obstacle or touch it, shape ``(...)``."""
        touching: BoolArray = self.signed_distance_m(position_enu_m) <= 0.0
        return touching

    def floor_m(self, position_enu_m: FloatArray) -> FloatArray:
        """Return the highest roof at each point's place on the ground, 0 on open ground.

        The vertical ray: whatever the point's own height. Shape ``(...)``.
        """
        position_m = _rows(position_enu_m)
        flat_m = _flat(position_m)
        floor_m = np.zeros(flat_m.shape[1])
        for part in _parts(len(floor_m), len(self._pieces)):
            pieces = self._pieces.rows(part)
            floor_m[part] = pieces.highest_roof(flat_m[0, part], flat_m[1, part])
        return floor_m.reshape(position_m.shape[:-1])

    def horizontal_rays(
        self, position_enu_m: FloatArray, azimuth_rad: FloatArray, range_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Look around at the vehicle's own height.

        Args:
            position_enu_m: Shape ``(..., 3)``.
            azimuth_rad: From map east (x) toward north (y), the paper's psi; ``(..., R)``, or
                ``(R,)`` for all alike.
            range_m: How far to look; a wall exactly there is still seen.

        Returns:
            ``distance_m`` to the first wall (``range_m`` where the view is free, 0 from inside)
            and ``roof_m``, the height of its roof (0 where the view is free), ``(..., R)`` each.
        """
        position_m = _rows(position_enu_m)
        azimuth_rad = np.asarray(azimuth_rad, dtype=np.float64)
        shape = (*position_m.shape[:-1], azimuth_rad.shape[-1])
        flat_m = _flat(position_m)
        direction = np.stack(
            [np.broadcast_to(wave(azimuth_rad), shape) for wave in (np.cos, np.sin)]
        ).reshape(2, -1, shape[-1])
        distance_m, roof_m = np.empty(direction.shape[1:]), np.empty(direction.shape[1:])
        for part in _parts(len(distance_m), len(self._pieces) * shape[-1]):
            distance_m[part], roof_m[part] = self._pieces.rows(part).cast(
                flat_m[:, part], direction[:, part], range_m
            )
        return distance_m.reshape(shape), roof_m.reshape(shape)

    def _signed_distance(self, position_m: FloatArray) -> FloatArray:
        """Return the least signed distance of ``(3, N)`` points, ``(N,)``."""
        if position_m.shape[1] == 1 and self._inverse_square.size <= _FEW:
            return np.asarray(self._signed_m(None, position_m).min(keepdims=True))
        return self._candidates(position_m)[-1]

    def _nearest(self, position_m: FloatArray) -> FloatArray:
        """Return the nearest surface points of ``(3, N)`` points, ``(3, N)``."""
        obstacle, point, signed_m, least_m = self._candidates(position_m)
        # Of equally near obstacles the first; a nan has none, and any will do.
        nearest = np.full(len(least_m), len(self))
        first = signed_m == least_m[point]
        np.minimum.at(nearest, point[first], obstacle[first])
        nearest[nearest == len(self)] = 0

        beside_m, above_m = self._beside_m(nearest, position_m), self._above_m(nearest, position_m)
        points = np.arange(len(nearest))
        from_m = position_m[:2, None] - self._corner_m.take(nearest, axis=-1)
        edge_m = self._edge_m.take(nearest, axis=-1)
        along = (from_m * edge_m).sum(axis=0) * self._inverse_square.take(nearest, axis=-1)
        to_wall_m = np.clip(along, 0.0, 1.0) * edge_m - from_m
        closest = np.square(to_wall_m).sum(axis=0).argmin(axis=0)

        # Inside go the shorter way, to a wall or up to the roof; outside go both ways.
        inside = (beside_m <= 0.0) & (above_m <= 0.0)
        to_wall = np.where(inside, beside_m > above_m, beside_m > 0.0)
        to_roof = np.where(inside, ~to_wall, above_m > 0.0)
        nearest_m = position_m.copy()
        nearest_m[:2] += np.where(to_wall, to_wall_m[:, closest, points], 0.0)
        nearest_m[2] -= np.where(to_roof, above_m, 0.0)
        return nearest_m

    def _candidates(
        self, position_m: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Return which obstacles may be nearest to which of ``(3, N)`` points.

        Boxes around the obstacles tell: none of those left out can be nearer. On a map of many
        obstacles a handful is left for each point.

        Returns:
            Pairs (obstacle, point) in the order of the obstacles, the signed distance of each,
            ``(P,)``, and the least of every point, ``(N,)``.
        """
        num_points = position_m.shape[1]
        if self._inverse_square.size * num_points <= _FEW:
            obstacle = np.arange(len(self)).repeat(num_points)
            point = np.tile(np.arange(num_points), len(self))
            least_m = np.full(num_points, np.inf)
        else:
            at_least_m = self._at_least_m(position_m)
            least_m = self._signed_m(at_least_m.argmin(axis=0), position_m)
            obstacle, point = np.nonzero(at_least_m <= least_m + _ROUNDING_M)
        signed_m = self._signed_m(obstacle, position_m[:, point])
        with np.errstate(invalid="ignore"):
            np.minimum.at(least_m, point, signed_m)
        return obstacle, point, signed_m, least_m

    def _at_least_m(self, position_m: FloatArray) -> FloatArray:
        """Return what the signed distances of ``(3, N)`` points are at least, ``(O, N)``."""
        low_x_m, low_y_m = self._low_m
        high_x_m, high_y_m = self._high_m
        at_least_m: FloatArray = np.maximum(low_x_m - position_m[0], position_m[0] - high_x_m)
        np.maximum(at_least_m, low_y_m - position_m[1], out=at_least_m)
        np.maximum(at_least_m, position_m[1] - high_y_m, out=at_least_m)
        np.maximum(at_least_m, position_m[2] - self._heights_m, out=at_least_m)
        return at_least_m

    def _signed_m(self, obstacle: IntArray | None, position_m: FloatArray) -> FloatArray:
        """Return the signed distance of ``(3, P)`` points to an obstacle each, ``(P,)``.

        ``None`` is all obstacles, for one point.
        """
        beside_m, above_m = (
            self._beside_m(obstacle, position_m),
            self._above_m(obstacle, position_m),
        )
        out_beside_m, out_above_m = np.maximum(beside_m, 0.0), np.maximum(above_m, 0.0)
        signed_m: FloatArray = np.sqrt(out_beside_m * out_beside_m + out_above_m * out_above_m)
        signed_m += np.minimum(np.maximum(beside_m, above_m), 0.0)
        return signed_m

    def _above_m(self, obstacle: IntArray | None, position_m: FloatArray) -> FloatArray:
        """Return how far points are above the roof of an obstacle each, ``(P,)``."""
        roof_m = self._heights_m[:, 0]
        above_m: FloatArray = position_m[2] - (roof_m if obstacle is None else roof_m[obstacle])
        return above_m

    def _beside_m(self, obstacle: IntArray | None, position_m: FloatArray) -> FloatArray:
        """Return how far points are from the outline of an obstacle each, negative within."""
        corner_m, edge_m, inverse_square = self._corner_m, self._edge_m, self._inverse_square
        if obstacle is not None:
            corner_m, edge_m = corner_m.take(obstacle, axis=-1), edge_m.take(obstacle, axis=-1)
            inverse_square = inverse_square.take(obstacle, axis=-1)
        corner_x_m, corner_y_m = corner_m
        edge_x_m, edge_y_m = edge_m
        from_x_m = position_m[0] - corner_x_m
        from_y_m = position_m[1] - corner_y_m
        along = from_x_m * edge_x_m + from_y_m * edge_y_m
        along *= inverse_square
        np.minimum(np.maximum(along, 0.0, out=along), 1.0, out=along)
        square_m2 = np.square(from_x_m - along * edge_x_m)
        square_m2 += np.square(from_y_m - along * edge_y_m)
        wall_m = np.sqrt(square_m2.min(axis=0))

        # Within, a line from the point toward east crosses the outline an odd number of times.
        north: BoolArray = from_y_m >= 0.0
        crosses = north != north.take(self._next_corner, axis=0)
        crosses &= (edge_x_m * from_y_m > edge_y_m * from_x_m) == (edge_y_m > 0.0)
        within = np.logical_xor.reduce(crosses, axis=0)
        beside_m: FloatArray = np.where(within, -wall_m, wall_m)
        return beside_m


def _rows(position_enu_m: FloatArray) -> FloatArray:
    return np.asarray(position_enu_m, dtype=np.float64)


def _flat(position_m: FloatArray) -> FloatArray:
    """Return points ``(..., 3)`` as columns, ``(3, N)``."""
    return np.ascontiguousarray(position_m.reshape(-1, 3).T)


def _parts(count: int, width: int) -> Iterator[slice]:
    """Cut ``count`` rows of ``width`` numbers into slices that fit the cache."""
    step = max(1, _CHUNK // max(1, width))
    for first in range(0, count, step):
        yield slice(first, first + step)
