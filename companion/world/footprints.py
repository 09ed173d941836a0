"""Footprints from people: checks that name the field, and one canonical form of each."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import shapely

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world.decomposition import Ring, counter_clockwise

MIN_AREA_M2 = 1e-4
"""A square centimetre: anything smaller is a slip of the pen."""


def check_footprints(
    footprints_m: Sequence[npt.ArrayLike], heights_m: Sequence[float], size_m: FloatArray
) -> tuple[FloatArray, ...]:
    """Return all outlines of a map, not closed, ``(V, 2)`` each, if they can be used.

    All are looked at together: a town has thousands. What is wrong is then looked for alone.

    Args:
        footprints_m: Corners, ``(V, 2)`` each; may repeat the first one at the end.
        heights_m: Of the roofs, one for each.
        size_m: Extent of the map, shape ``(3,)``.

    Raises:
        MapError: As ``check_footprint`` for the first that is wrong.
    """
    outlines_m = [_outline(footprint) for footprint in footprints_m]
    count = np.array([len(outline_m) for outline_m in outlines_m], dtype=np.int64)
    sound = (count >= 3) & (np.asarray(heights_m) > 0.0) & (np.asarray(heights_m) <= size_m[2])
    corner_m = np.concatenate([*outlines_m, np.empty((0, 2))])
    outline = np.repeat(np.arange(len(count)), count)
    within = np.all((corner_m >= 0.0) & (corner_m <= size_m[:2]), axis=1)
    sound[outline[~within]] = False
    first = np.cumsum(count) - count
    before = np.arange(len(corner_m)) - 1
    before[first[count > 0]] = (first + count - 1)[count > 0]
    sound[outline[np.all(corner_m == corner_m[before], axis=1)]] = False
    usable = sound[outline]
    # Rings are numbered without a gap; they close themselves.
    number = np.cumsum(sound)[outline[usable]] - 1
    polygons = shapely.polygons(shapely.linearrings(corner_m[usable], indices=number))
    area_m2 = shapely.area(shapely.convex_hull(polygons))
    sound[sound] = (area_m2 >= MIN_AREA_M2) & shapely.is_valid(polygons)
    for index in np.flatnonzero(~sound).tolist():
        check_footprint(f"obstacles[{index}]", footprints_m[index], heights_m[index], size_m)
    return tuple(outlines_m)


def check_footprint(
    field: str, footprint_m: npt.ArrayLike, height_m: float, size_m: FloatArray
) -> FloatArray:
    """Return an obstacle's outline, not closed, ``(V, 2)``, if it can be used.

    Args:
        field: What to call the obstacle in errors, such as ``obstacles[2]``.
        footprint_m: Corners, ``(V, 2)``; may repeat the first one at the end.
        height_m: Height of the roof.
        size_m: Extent of the map, shape ``(3,)``.

    Raises:
        MapError: If the outline is no simple polygon within the map or the height is not between
            0 and the map's. The message names field and place.
    """
    corners_m = _outline(footprint_m)
    outline = f"{field}.footprint_m"
    if len(corners_m) < 3:
        raise MapError(f"{outline} needs at least 3 corners, got {len(corners_m)}")
    # Written so that nan fails too.
    outside = ~np.all((corners_m >= 0.0) & (corners_m <= size_m[:2]), axis=1)
    if outside.any():
        index = int(outside.argmax())
        raise MapError(
            f"{outline}[{index}] {_place(corners_m[index])} is outside the map "
            f"({size_m[0]:g} x {size_m[1]:g} m)"
        )
    repeated = np.all(corners_m == np.roll(corners_m, 1, axis=0), axis=1)
    if repeated.any():
        raise MapError(f"{outline}[{int(repeated.argmax())}] repeats the corner before it")
    polygon = shapely.Polygon(corners_m)
    if polygon.convex_hull.area < MIN_AREA_M2:
        raise MapError(f"{outline} has no area")
    reason = shapely.is_valid_reason(polygon)
    if reason != "Valid Geometry":
        raise MapError(f"{outline} {_explain(reason)}")
    if not 0.0 < height_m <= size_m[2]:
        raise MapError(
            f"{field}.height_m must be above 0 and at most the map's {size_m[2]:g} m, "
            f"got {height_m}"
        )
    return corners_m


def _outline(footprint_m: npt.ArrayLike) -> FloatArray:
    corners_m = np.array(footprint_m, dtype=np.float64).reshape(-1, 2)
    closed = len(corners_m) > 1 and bool((corners_m[0] == corners_m[-1]).all())
    return corners_m[:-1] if closed else corners_m


def canonical_footprint(footprint_m: FloatArray) -> Ring:
    """Return an outline counter-clockwise from its smallest corner: one form of equal shapes."""
    ring = counter_clockwise([(float(x) + 0.0, float(y) + 0.0) for x, y in footprint_m])
    first = ring.index(min(ring))
    return ring[first:] + ring[:first]


def _explain(reason: str) -> str:
    """Turn shapely's ``Self-intersection[3 4]`` into words."""
    kind, _, place = reason.rstrip("]").partition("[")
    at = _place(np.array([float(value) for value in place.split()[:2]]))
    if kind == "Self-intersection":
        return f"crosses itself near {at}"
    if kind == "Ring Self-intersection":
        return f"touches itself near {at}"
    return f"is no simple polygon near {at} ({kind})"


def _place(point_m: FloatArray) -> str:
    return f"({float(point_m[0])}, {float(point_m[1])})"
