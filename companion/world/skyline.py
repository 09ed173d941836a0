"""How high the obstacles stand around every point of the ground: a raster for quick questions.

Obstacles are prisms on the ground, so one number for each point says all of them: below it
something is nearer than the margin, above it nothing is. Reading it costs an array access where
the exact question costs a walk over walls.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely

from companion.arrays import Float32Array, FloatArray
from companion.world.maps import Map

MARGINS_M = (0.5, 2.0, 3.0)
"""Beside a wall, within the shield's margin of it, and within a little more."""
BESIDE, NEAR, FAR = range(len(MARGINS_M))
OPEN_M = -1.0
"""Where nothing stands: below the ground, so that a vehicle on it is free."""
_NODES_A_PART = 2_000


@dataclass(frozen=True, slots=True, eq=False)
class Skyline:
    """Heights at the nodes of a square raster, from its south-west node on."""

    low_m: FloatArray  # (2,)
    """The south-west node, east and north on the map."""
    spacing_m: float
    height_m: Float32Array  # (len(MARGINS_M), nodes east, nodes north)
    """Highest roof within each margin, plus the margin; ``OPEN_M`` where there is none. The sides
    of the map, from which the shield keeps off as well, count as walls but for the least margin."""

    @classmethod
    def survey(
        cls, city: Map, low_m: FloatArray, nodes: tuple[int, int], spacing_m: float
    ) -> Iterator["Skyline | None"]:
        """Survey a piece of a map, bit by bit.

        Args:
            city: The map.
            low_m: The south-west node, shape ``(2,)``.
            nodes: How many east and north.
            spacing_m: Between two nodes.

        Yields:
            ``None`` after each part of the work, at last the skyline.
        """
        east_m, north_m = (low_m[axis] + spacing_m * np.arange(nodes[axis]) for axis in (0, 1))
        ground_m = np.stack(np.meshgrid(east_m, north_m, indexing="ij"), axis=-1).reshape(-1, 2)
        height_m = np.full((len(MARGINS_M), len(ground_m)), OPEN_M, dtype=np.float32)
        inside_m = np.minimum(ground_m, city.size_m[:2] - ground_m).min(axis=1)
        for raster_m, margin_m in zip(height_m[1:], MARGINS_M[1:], strict=True):
            raster_m[inside_m < margin_m] = city.size_m[2]
        yield None
        outlines = np.array([shapely.Polygon(outline) for outline in city.footprints_m])
        tree = shapely.STRtree(outlines)
        yield None
        for first in range(0, len(ground_m), _NODES_A_PART):
            points = shapely.points(ground_m[first : first + _NODES_A_PART])
            node, outline = tree.query(points, predicate="dwithin", distance=MARGINS_M[-1])
            distance_m = shapely.distance(points[node], outlines[outline])
            for raster_m, margin_m in zip(height_m, MARGINS_M, strict=True):
                within = distance_m <= margin_m
                roof_m = city.heights_m[outline[within]] + margin_m
                np.maximum.at(raster_m, first + node[within], roof_m.astype(np.float32))
            yield None
        yield cls(low_m, spacing_m, height_m.reshape(-1, *nodes))
