"""One building from earth to the map: projected, repaired, cut to the box, simplified."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from companion.arrays import FloatArray
from companion.world import footprints
from companion.world.frames import ground_to_enu
from companion.world.import_report import MIN_AREA_M2
from companion.world.map_box import GRID_M, MapBox

_WIDEST_DEG = 1.0
"""An outline that is wider runs round the earth."""


@dataclass(slots=True)
class Placed:
    """What lies in the box of one building, and what was done to it."""

    polygons: list[shapely.Polygon] = field(default_factory=list)
    """Valid, in map ENU, corners on the grid, holes of at least ``MIN_AREA_M2``."""
    inside: bool = False
    """Something lay in the box, if only a sliver."""
    repaired: bool = False
    clipped: bool = False
    invalid: int = 0
    """Outlines without area."""
    tiny: int = 0
    """Parts too small to keep."""
    filled: int = 0
    """Holes too small to keep."""


def place(polygons_deg: Sequence[Sequence[FloatArray]], box: MapBox, tolerance_m: float) -> Placed:
    """Lay a building into a box.

    Args:
        polygons_deg: For each polygon its rings, the outer one first, ``(V, 2)`` each, longitude
            and latitude, not closed.
        box: The ground of the map.
        tolerance_m: By how much outlines may change to have fewer corners.
    """
    placed = Placed()
    lying: list[shapely.Geometry] = []
    ground = shapely.box(0.0, 0.0, box.east_m, box.north_m)
    low_deg, high_deg = box.bounds_deg
    for rings_deg in polygons_deg:
        if not rings_deg or len(rings_deg[0]) < 3:
            placed.invalid += 1
            continue
        least_deg, most_deg = rings_deg[0].min(axis=0), rings_deg[0].max(axis=0)
        if np.any(least_deg > high_deg) or np.any(most_deg < low_deg):
            continue
        if np.any(most_deg - least_deg > _WIDEST_DEG):
            placed.invalid += 1
            continue
        polygon = _to_plane(rings_deg, box)
        if not polygon.is_valid:
            polygon = shapely.make_valid(polygon, method="structure", keep_collapsed=False)
            placed.repaired = True
        if polygon.area < footprints.MIN_AREA_M2:
            placed.invalid += 1
            continue
        if not ground.covers(polygon):
            polygon = polygon.intersection(ground)
            placed.clipped = True
        if polygon.area > 0.0:
            placed.inside = True
            lying.append(polygon)
    # Parts of one building that touch are one: fewer walls, and none inside.
    for part in shapely.get_parts(shapely.union_all(lying)) if len(lying) > 1 else lying:
        simple = shapely.simplify(part, tolerance_m, preserve_topology=True)
        _add_parts(placed, shapely.set_precision(simple, GRID_M))
    return placed


def _to_plane(rings_deg: Sequence[FloatArray], box: MapBox) -> shapely.Polygon:
    rings_m = [
        ground_to_enu(box.origin, latitude_deg=ring[:, 1], longitude_deg=ring[:, 0])
        for ring in rings_deg
        if len(ring) >= 3
    ]
    return shapely.Polygon(rings_m[0], rings_m[1:])


def _add_parts(placed: Placed, shape: shapely.Geometry) -> None:
    """Keep the polygons of a shape that are large enough, without holes that are not."""
    parts = [part for part in shapely.get_parts(shape) if part.area > 0.0]
    if not parts:  # thinner than the grid
        placed.tiny += 1
    for part in parts:
        if shapely.Polygon(part.exterior).area < MIN_AREA_M2:
            placed.tiny += 1
            continue
        holes = [ring for ring in part.interiors if shapely.Polygon(ring).area >= MIN_AREA_M2]
        placed.filled += len(part.interiors) - len(holes)
        placed.polygons.append(shapely.Polygon(part.exterior, holes))
