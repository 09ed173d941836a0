"""Cut a polygon with holes into simple polygons without: courtyards stay open to the sky."""

import numpy as np
import shapely

from companion.arrays import FloatArray

_Corner = tuple[float, float]


def cut_holes(polygon: shapely.Polygon) -> list[FloatArray]:
    """Return simple polygons, ``(V, 2)`` each, not closed, that cover exactly the same ground.

    The cuts run from corner to corner, along edges of a constrained Delaunay triangulation: no
    corner is added or moved, so parts share whole edges and nothing opens between them. A polygon
    without holes comes back as it is.

    Args:
        polygon: A valid polygon, with any number of holes.
    """
    if not polygon.interiors:
        return [np.array(polygon.exterior.coords)[:-1, :2]]
    triangles = [
        _left_turning([(float(x), float(y)) for x, y in triangle.exterior.coords[:3]])
        for triangle in shapely.constrained_delaunay_triangles(polygon).geoms
    ]
    beside = {
        (triangle[k], triangle[(k + 1) % 3]): (number, triangle[(k + 2) % 3])
        for number, triangle in enumerate(triangles)
        for k in range(3)
    }
    taken: set[int] = set()
    parts = []
    for number, triangle in enumerate(triangles):
        if number not in taken:
            taken.add(number)
            parts.append(np.array(_grow(triangle, beside, taken)))
    return parts


def _grow(
    triangle: list[_Corner],
    beside: dict[tuple[_Corner, _Corner], tuple[int, _Corner]],
    taken: set[int],
) -> list[_Corner]:
    """Join a triangle with all it can reach while no corner appears twice: never round a hole.

    Args:
        triangle: Where to begin, counter-clockwise.
        beside: For every directed edge, the triangle to its left and that one's third corner.
        taken: Triangles that belong to a part; grows.
    """
    after = dict(zip(triangle, triangle[1:] + triangle[:1], strict=True))
    edges = list(after.items())
    while edges:
        first, second = edges.pop()
        number, third = beside.get((second, first), (-1, first))
        if number < 0 or number in taken or third in after:
            continue
        taken.add(number)
        after[first], after[third] = third, second
        edges += [(first, third), (third, second)]
    ring = [triangle[0]]
    while after[ring[-1]] != ring[0]:
        ring.append(after[ring[-1]])
    return ring


def _left_turning(triangle: list[_Corner]) -> list[_Corner]:
    (ax, ay), (bx, by), (cx, cy) = triangle
    return triangle if (bx - ax) * (cy - ay) >= (by - ay) * (cx - ax) else triangle[::-1]
