"""Convex prisms as packed half-spaces: where segments and rays go in and out.

Every prism is a convex base extruded from far below the ground to a flat roof, closed: a point on
a wall or on the roof belongs to it. A half-space of an edge shared by two pieces is bit for bit
the opposite in the other piece, so nothing slips through between them.

Arrays are ``(edges, pieces)``; work arrays put the batch last, where numpy is fastest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.decomposition import convex_pieces

_FEW = 64
"""Pieces up to which it is quicker to cast every ray of a point at all of them."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvexPieces:
    """``K`` convex prisms with at most ``E`` edges each; missing edges are always satisfied."""

    normal_x: FloatArray  # (E, K)
    """Outward unit normals."""
    normal_y: FloatArray  # (E, K)
    offset_m: FloatArray  # (E, K)
    """A point is inside an edge's half-plane when ``normal . point <= offset``."""
    roof_m: FloatArray  # (K,)
    low_x_m: FloatArray  # (K, 1)
    high_x_m: FloatArray  # (K, 1)
    low_y_m: FloatArray  # (K, 1)
    high_y_m: FloatArray  # (K, 1)
    center_m: FloatArray  # (2, K)
    """Of a circle around each base."""
    radius_m: FloatArray  # (K,)

    @classmethod
    def of(cls, footprints_m: Sequence[FloatArray], heights_m: FloatArray) -> "ConvexPieces":
        """Cut footprints into convex pieces and pack them."""
        pieces = [convex_pieces(footprint) for footprint in footprints_m]
        bases = [base for cut in pieces for base in cut]
        planes = _half_planes(bases)
        low_m = np.array([base.min(axis=0) for base in bases]).reshape(-1, 2)
        high_m = np.array([base.max(axis=0) for base in bases]).reshape(-1, 2)
        size_m = high_m - low_m
        normal_x, normal_y, offset_m = planes
        return cls(
            normal_x=normal_x,
            normal_y=normal_y,
            offset_m=offset_m,
            roof_m=np.repeat(heights_m, np.array([len(cut) for cut in pieces], dtype=np.int64)),
            low_x_m=low_m[:, :1],
            high_x_m=high_m[:, :1],
            low_y_m=low_m[:, 1:],
            high_y_m=high_m[:, 1:],
            center_m=(low_m + 0.5 * size_m).T,
            # One part in a million wider: rounding must not lose a corner.
            radius_m=0.5000005 * np.hypot(size_m[:, 0], size_m[:, 1]),
        )

    def __len__(self) -> int:
        return len(self.roof_m)

    def rows(self, rows: slice | IntArray) -> "ConvexPieces":
        """Return what ``rows`` of a batch can meet: here all of it, in an atlas of maps a part."""
        return self

    def near(self, low_m: FloatArray, high_m: FloatArray) -> "ConvexPieces":
        """Return the pieces that reach into a box of the ground, corners of shape ``(2,)``."""
        here = (self.low_x_m <= high_m[0]) & (self.high_x_m >= low_m[0])
        here &= (self.low_y_m <= high_m[1]) & (self.high_y_m >= low_m[1])
        kept = here[:, 0]
        return ConvexPieces(
            normal_x=self.normal_x[:, kept],
            normal_y=self.normal_y[:, kept],
            offset_m=self.offset_m[:, kept],
            roof_m=self.roof_m[kept],
            low_x_m=self.low_x_m[kept],
            high_x_m=self.high_x_m[kept],
            low_y_m=self.low_y_m[kept],
            high_y_m=self.high_y_m[kept],
            center_m=self.center_m[:, kept],
            radius_m=self.radius_m[kept],
        )

    def covered(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray:
        """Return the fraction of each segment inside the union of the prisms, ``(N,)``.

        Args:
            start_m: Shape ``(3, N)``.
            end_m: Shape ``(3, N)``.
        """
        piece, segment = self._near(np.minimum(start_m, end_m), np.maximum(start_m, end_m))
        if len(piece) == 0:
            return np.zeros(start_m.shape[1])
        before, after = _clip(
            self._outside_m(piece, start_m[:, segment]), self._outside_m(piece, end_m[:, segment])
        )
        leave = 1.0 - after
        inside = leave > before
        return _union(segment[inside], before[inside], leave[inside], start_m.shape[1])

    def highest_roof(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the highest roof at points of the ground, 0 where there is none, ``(N,)``."""
        ground_m = np.stack((x_m, y_m, np.full_like(x_m, -np.inf)))
        piece, point = self._near(ground_m, ground_m)
        if len(piece) == 0:
            return np.zeros(len(x_m))
        inside = (self._outside_m(piece, ground_m[:, point]) <= 0.0).all(axis=0)
        roof_m = np.zeros(len(x_m))
        np.maximum.at(roof_m, point[inside], self.roof_m[piece[inside]])
        return roof_m

    def cast(
        self, position_m: FloatArray, direction: FloatArray, range_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Cast horizontal rays.

        Args:
            position_m: Where from, shape ``(3, N)``.
            direction: Horizontal unit vectors, shape ``(2, N, R)``.
            range_m: How far; a wall exactly there is still seen.

        Returns:
            Distance to the first wall (``range_m`` where there is none, 0 from inside) and the
            height of its roof (0 where there is none; the highest where walls coincide), both of
            shape ``(N, R)``.
        """
        num_points, num_rays = direction.shape[1:]
        reach_m = np.array([[range_m], [range_m], [0.0]])
        piece, point = self._near(position_m - reach_m, position_m + reach_m)
        if num_points == 1 and len(piece) <= _FEW:
            return self._cast_all(piece, position_m, direction, range_m)
        distance_m = np.full(num_points * num_rays, range_m, dtype=np.float64)
        roof_m = np.zeros(num_points * num_rays)
        from_m = position_m[:, point]
        seen = np.flatnonzero(self._in_sight(piece, from_m, direction.take(point, axis=1)))
        pair, ray = np.divmod(seen, num_rays)
        ray += point[pair] * num_rays
        start_outside = self._outside_m(piece, from_m).take(pair, axis=1)
        piece = piece[pair]
        along_x_m, along_y_m = direction.reshape(2, -1).take(ray, axis=1) * range_m
        end_outside = start_outside.copy()
        end_outside[:-1] += self.normal_x.take(piece, axis=1) * along_x_m
        end_outside[:-1] += self.normal_y.take(piece, axis=1) * along_y_m
        before, after = _clip(start_outside, end_outside)
        hit = before + after <= 1.0
        piece, ray, hit_m = piece[hit], ray[hit], before[hit] * range_m
        np.minimum.at(distance_m, ray, hit_m)
        first = hit_m == distance_m[ray]
        np.maximum.at(roof_m, ray[first], self.roof_m[piece[first]])
        return distance_m.reshape(num_points, -1), roof_m.reshape(num_points, -1)

    def _cast_all(
        self, piece: IntArray, position_m: FloatArray, direction: FloatArray, range_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Cast all rays of one point at all of some pieces: dearer, but in few steps.

        The numbers are those of ``cast`` to the last bit.
        """
        if len(piece) == 0:
            return np.full(direction.shape[1:], range_m), np.zeros(direction.shape[1:])
        along_m = direction * range_m  # (2, 1, R)
        start_outside = self._outside_m(piece, position_m)[..., None]  # (E + 1, P, 1)
        end_outside = np.empty((*start_outside.shape[:2], along_m.shape[-1]))
        end_outside[:] = start_outside
        end_outside[:-1] += self.normal_x.take(piece, axis=1)[..., None] * along_m[0]
        end_outside[:-1] += self.normal_y.take(piece, axis=1)[..., None] * along_m[1]
        before, after = _clip(start_outside, end_outside)
        hit = before + after <= 1.0
        hit_m = np.where(hit, before * range_m, np.inf)
        distance_m = hit_m.min(axis=0)
        first = hit & (hit_m == distance_m)
        roof_m = np.where(first, self.roof_m[piece, None], 0.0).max(axis=0)
        return np.minimum(distance_m, range_m)[None], roof_m[None]

    def _near(self, low_m: FloatArray, high_m: FloatArray) -> tuple[IntArray, IntArray]:
        """Return the pairs (piece, box) that overlap; boxes are ``(3, N)``."""
        overlap: BoolArray = self.low_x_m <= high_m[0]
        overlap &= self.high_x_m >= low_m[0]
        overlap &= self.low_y_m <= high_m[1]
        overlap &= self.high_y_m >= low_m[1]
        overlap &= self.roof_m[:, None] >= low_m[2]
        piece, box = np.nonzero(overlap)
        return piece, box

    def _outside_m(self, piece: IntArray, point_m: FloatArray) -> FloatArray:
        """Return how far points ``(3, P)`` lie outside every half-space, ``(E + 1, P)``."""
        outside_m = np.empty((len(self.offset_m) + 1, len(piece)))
        walls_m = outside_m[:-1]
        np.multiply(self.normal_x.take(piece, axis=1), point_m[0], out=walls_m)
        walls_m += self.normal_y.take(piece, axis=1) * point_m[1]
        walls_m -= self.offset_m.take(piece, axis=1)
        np.subtract(point_m[2], self.roof_m[piece], out=outside_m[-1])
        return outside_m

    def _in_sight(self, piece: IntArray, from_m: FloatArray, direction: FloatArray) -> BoolArray:
        """Return which rays ``(2, P, R)`` meet the circle around their piece, ``(P, R)``."""
        to_center_m = self.center_m[:, piece] - from_m[:2]
        # A tangent's length: a ray that meets the circle gets farther than that toward its center.
        # From within the circle all do.
        tangent_m2 = np.square(to_center_m).sum(axis=0) - np.square(self.radius_m[piece])
        least_m = np.sqrt(np.maximum(tangent_m2, 0.0))
        least_m[tangent_m2 <= 0.0] = -np.inf
        toward_m = to_center_m[0, :, None] * direction[0]
        toward_m += to_center_m[1, :, None] * direction[1]
        seen: BoolArray = toward_m >= least_m[:, None]
        return seen


def _half_planes(bases: Sequence[FloatArray]) -> FloatArray:
    """Return normals and offsets of the edges of counter-clockwise polygons, ``(3, E, K)``."""
    count = np.array([len(base) for base in bases], dtype=np.int64)
    planes = np.zeros((3, int(count.max(initial=0)), len(bases)))
    planes[2] = 1.0  # 0 x + 0 y <= 1 holds everywhere
    corner = np.concatenate([*bases, np.empty((0, 2))])
    first = np.cumsum(count) - count
    piece = np.repeat(np.arange(len(bases)), count)
    edge = np.arange(len(corner)) - first[piece]
    after = corner[first[piece] + (edge + 1) % count[piece]]
    # From the smaller corner to the larger, whichever piece asks: opposite signs, same bits.
    swapped = np.where(
        corner[:, 0] == after[:, 0], corner[:, 1] > after[:, 1], corner[:, 0] > after[:, 0]
    )
    start = np.where(swapped[:, None], after, corner)
    along_x, along_y = (np.where(swapped[:, None], corner, after) - start).T
    length_m = np.hypot(along_x, along_y)
    normal_x, normal_y = along_y / length_m, -along_x / length_m
    found = np.stack((normal_x, normal_y, normal_x * start[:, 0] + normal_y * start[:, 1]))
    planes[:, edge, piece] = np.where(swapped, -found, found)
    return planes


def _clip(start_outside: FloatArray, end_outside: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cut segments by half-spaces.

    Args:
        start_outside: How far the starts are outside each half-space, shape ``(E, P)``.
        end_outside: The same for the ends.

    Returns:
        Fractions of the segments before they enter and after they leave, ``(P,)``. A sum above 1
        means that they never enter.
    """
    # Along or away from a wall, dividing by zero gives +inf outside: never in; -inf inside: no
    # limit; nan on the wall, which fmax skips: no limit either, the set is closed. Both ways are
    # differences: a negated zero would turn the infinities around.
    approach = np.maximum(start_outside - end_outside, 0.0)
    retreat = np.maximum(end_outside - start_outside, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before = np.fmax.reduce(start_outside / approach, axis=0, initial=0.0)
        after = np.fmax.reduce(end_outside / retreat, axis=0, initial=0.0)
    return before, after


def _union(segment: IntArray, enter: FloatArray, leave: FloatArray, count: int) -> FloatArray:
    """Return the length of the union of each segment's intervals, ``(count,)``."""
    order = np.lexsort((enter, segment))
    segment, enter, leave = segment[order], enter[order], leave[order]
    per_segment = np.bincount(segment, minlength=count)
    rank = np.arange(len(segment)) - (np.cumsum(per_segment) - per_segment)[segment]
    table = np.full((2, int(per_segment.max(initial=0)) + 1, count), -np.inf)
    table[0, 1:] = np.inf
    table[0, rank + 1, segment] = enter
    table[1, rank + 1, segment] = leave
    reached = np.maximum.accumulate(table[1], axis=0)
    gain = table[1, 1:] - np.maximum(table[0, 1:], reached[:-1])
    covered: FloatArray = np.maximum(gain, 0.0).sum(axis=0)
    return covered
