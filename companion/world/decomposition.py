"""Cut a simple polygon, convex or not, into convex pieces that share whole edges."""

import numpy as np
import shapely

from companion.arrays import FloatArray

Ring = list[tuple[float, float]]


def convex_pieces(footprint_m: FloatArray) -> list[FloatArray]:
    """Return convex polygons, counter-clockwise, whose union is the footprint.

    A constrained Delaunay triangulation, merged greedily while pieces stay convex (Hertel and
    Mehlhorn 1983: at most four times the least possible number). No vertex is added, so pieces
    meet along whole edges and a half-plane of one is exactly the opposite of its neighbour's.

    Args:
        footprint_m: A simple polygon, shape ``(V, 2)``, not closed, either orientation.
    """
    ring = counter_clockwise([(float(x), float(y)) for x, y in footprint_m])
    if _is_convex(ring):
        return [np.array(ring)]
    triangles = shapely.constrained_delaunay_triangles(shapely.Polygon(ring)).geoms
    pieces = [
        counter_clockwise([(float(x), float(y)) for x, y in triangle.exterior.coords[:-1]])
        for triangle in triangles
    ]
    return [np.array(piece) for piece in _merge(pieces)]


def counter_clockwise(ring: Ring) -> Ring:
    """Return the ring so that its inside lies to the left of every edge."""
    twice_area = sum(
        (x - ring[0][0]) * (next_y - y) - (next_x - x) * (y - ring[0][1])
        for (x, y), (next_x, next_y) in zip(ring, ring[1:] + ring[:1], strict=True)
    )
    return ring if twice_area >= 0.0 else ring[::-1]


def _merge(pieces: list[Ring]) -> list[Ring]:
    """Join pieces across shared edges for as long as the result is convex."""
    done: list[Ring] = []
    while pieces:
        piece = pieces.pop()
        joined = next(
            ((other, ring) for other in pieces if (ring := _join(piece, other)) is not None), None
        )
        if joined is None:
            done.append(piece)
        else:
            other, ring = joined
            pieces.remove(other)
            pieces.append(ring)
    return done


def _join(piece: Ring, other: Ring) -> Ring | None:
    """Return both as one ring, or ``None`` if they share no edge or are not convex together."""
    for index, first in enumerate(piece):
        second = piece[(index + 1) % len(piece)]
        if first in other and second in other:
            start = other.index(first)
            if other[start - 1] != second:
                continue
            # From the shared edge's end round this piece to its start, then round the other.
            way = piece[index + 1 :] + piece[: index + 1]
            other_way = other[start + 1 :] + other[:start]
            ring = way + other_way[:-1]
            return ring if _is_convex(ring) else None
    return None


def _is_convex(ring: Ring) -> bool:
    """Return whether a counter-clockwise simple ring turns left, or not at all, everywhere."""
    return all(
        (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) >= 0.0
        for a, b, c in zip(ring[-1:] + ring[:-1], ring, ring[1:] + ring[:1], strict=True)
    )
