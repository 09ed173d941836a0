"""Shortest ways with full knowledge of a map: a visibility graph over the obstacles' corners.

In the plane shortest ways bend at corners of outlines only. Among prisms they also bend on edges,
at places between; the graph has nodes a few metres apart up every corner and along the rim of
every roof, and its ways are longer than the shortest by little.
It is meant for the paper's maps; the graph of a whole town would be too large.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from companion.arrays import FloatArray, IntArray
from companion.world.maps import Map

_MARGIN_M = 0.3
"""Nodes stand off the walls by this, so that rounding does not touch them."""
_LEVEL_M = 7.5
"""Between two nodes of an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibilityGraph:
    """Nodes around the obstacles of a map and the shortest ways between any two of them."""

    city: Map
    node_m: FloatArray  # (V, 3)
    length_m: FloatArray  # (V, V)
    """Of the shortest way; infinite where there is none."""
    next_node: IntArray  # (V, V)
    """First step of it."""

    @classmethod
    def of(cls, city: Map) -> "VisibilityGraph":
        """Build the graph of a map."""
        node_m = _corners_m(city)
        count = len(node_m)
        length_m = np.full((count, count), np.inf)
        for number, position_m in enumerate(node_m):
            length_m[number] = _seen_m(city, position_m, node_m)
        length_m = np.minimum(length_m, length_m.T)
        next_node = np.tile(np.arange(count), (count, 1))
        for via in range(count):  # Floyd and Warshall
            detour_m = length_m[:, via : via + 1] + length_m[via]
            shorter = detour_m < length_m
            length_m = np.where(shorter, detour_m, length_m)
            next_node = np.where(shorter, next_node[:, via : via + 1], next_node)
        return cls(city, node_m, length_m, next_node)

    def way(self, start_m: FloatArray, target_m: FloatArray) -> FloatArray:
        """Return the corners of the shortest way, ``(K, 3)``, both ends included.

        Where there is no way, or none that the graph knows, it is the straight line.
        """
        straight = np.stack((start_m, target_m))
        if len(self.node_m) == 0 or _is_clear(self.city, start_m, target_m):
            return straight
        away_m = _seen_m(self.city, start_m, self.node_m)
        home_m = _seen_m(self.city, target_m, self.node_m)
        first, last = np.flatnonzero(np.isfinite(away_m)), np.flatnonzero(np.isfinite(home_m))
        if len(first) == 0 or len(last) == 0:
            return straight
        total_m = away_m[first, None] + self.length_m[np.ix_(first, last)] + home_m[last]
        best = np.unravel_index(np.argmin(total_m), total_m.shape)
        if not np.isfinite(total_m[best]):
            return straight
        node, end = int(first[best[0]]), int(last[best[1]])
        nodes = [node]
        while node != end:
            node = int(self.next_node[node, end])
            nodes.append(node)
        return np.concatenate((start_m[None], self.node_m[nodes], target_m[None]))


class ShortestWays:
    """Finds shortest ways on any map; the graph of each is built once."""

    def __init__(self) -> None:
        self._graphs: dict[str, VisibilityGraph] = {}

    def __call__(self, city: Map, start_m: FloatArray, target_m: FloatArray) -> list[FloatArray]:
        """Return the shortest way of each pair, ``(K, 3)`` each.

        Args:
            city: The map.
            start_m: Free points, shape ``(N, 3)``.
            target_m: Shape ``(N, 3)``.
        """
        if city.content_hash not in self._graphs:
            self._graphs[city.content_hash] = VisibilityGraph.of(city)
        graph = self._graphs[city.content_hash]
        return [graph.way(*ends) for ends in zip(start_m, target_m, strict=True)]


def way_lengths_m(ways: Sequence[FloatArray]) -> FloatArray:
    """Return the length of each way, ``(N,)``."""
    return np.array([np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in ways])


def _corners_m(city: Map) -> FloatArray:
    """Return the free points just off every edge, a few metres apart."""
    points: list[tuple[float, float, float]] = []
    top_m = float(city.size_m[2])
    for footprint_m, height_m in zip(city.footprints_m, city.heights_m, strict=True):
        around = shapely.Polygon(footprint_m).buffer(_MARGIN_M, join_style="mitre")
        roof_m = min(float(height_m) + _MARGIN_M, top_m)
        points += [
            (east_m, north_m, up_m)
            for east_m, north_m in around.exterior.coords[:-1]
            for up_m in np.arange(0.0, roof_m, _LEVEL_M)
        ]
        rim = shapely.segmentize(around.exterior, _LEVEL_M)
        points += [(east_m, north_m, roof_m) for east_m, north_m in rim.coords[:-1]]
    corners_m = np.array(points).reshape(-1, 3)
    free: FloatArray = corners_m[city.is_free(corners_m)]
    return free


def _is_clear(city: Map, from_m: FloatArray, to_m: FloatArray) -> bool:
    return float(city.obstacles.crash_depth_m(from_m, to_m)) == 0.0


def _seen_m(city: Map, from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """Return the distances ``(V,)`` to points in plain sight, infinite to the others."""
    clear = city.obstacles.crash_depth_m(from_m, to_m) == 0.0
    return np.where(clear, np.linalg.norm(to_m - from_m, axis=1), np.inf)
