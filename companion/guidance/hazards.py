"""What the shield keeps away from: obstacles, the ground and the faces of the box, all alike.

Every hazard is a convex body, the points with ``normal . p <= offset`` for all its planes: the
convex pieces of the footprints with their roofs, and a half-space for the ground and each face of
the box. The distance to a body is the largest of the distances to its planes: exact in front of
a face, and too small (on the safe side) where an edge is nearest. A plane across every vertical
edge bounds that: by 8 % at a right angle, by 30 % at the sharpest. Two across every edge of a
roof do the same.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.decomposition import convex_pieces
from companion.world.maps import Map

_SQUARE_M = 5.0
_NUM_SQUARES = 1024
_SQUARES_A_BLOCK = 20
_NUM_BLOCKS = 4
"""How many squares, and how many blocks of ``_SQUARES_A_BLOCK`` by as many, are remembered."""
_EAVES_RAD = np.radians([20.0, 55.0])
"""How far the planes between wall and roof look up. The first lets a vehicle go over that is a
third of a metre above the roof, beside it."""


class Kind(IntEnum):
    """What a hazard is."""

    OBSTACLE = 0
    GROUND = 1
    FENCE = 2


@dataclass(frozen=True, slots=True)
class Hazards:
    """Convex bodies, ``B`` of them with up to ``F`` planes each, and how far to keep off each."""

    normal: FloatArray
    """Unit, outward, ``(B, F, 3)``; zero where a body has fewer planes."""
    offset_m: FloatArray
    """``(B, F)``."""
    keep_m: FloatArray
    """``(B,)``."""
    kind: IntArray
    """``(B,)``, of ``Kind``."""

    @classmethod
    def of_map(cls, city: Map, *, margin_m: float, min_height_m: float) -> "Hazards":
        """Return the hazards of a map.

        Args:
            city: The map.
            margin_m: To be kept from obstacles, and from the sides and the top of the box.
            min_height_m: To be kept above the ground.
        """
        pieces = [
            (piece, float(height_m))
            for footprint_m, height_m in zip(city.footprints_m, city.heights_m, strict=True)
            for piece in convex_pieces(footprint_m)
        ]
        bodies = [_prism_planes(piece, height_m) for piece, height_m in pieces]
        num_pieces = len(bodies)
        axes = np.eye(3)
        bodies.append((axes[2:], np.zeros(1)))
        for axis, size_m in enumerate(city.size_m):
            bodies.append((-axes[axis : axis + 1], np.array([-size_m])))
            if axis < 2:
                bodies.append((axes[axis : axis + 1], np.zeros(1)))
        num_planes = max(len(offset_m) for _, offset_m in bodies)
        normal = np.zeros((len(bodies), num_planes, 3))
        offset = np.full((len(bodies), num_planes), np.inf)
        for row, (planes, offset_m) in enumerate(bodies):
            normal[row, : len(planes)], offset[row, : len(planes)] = planes, offset_m
        keep = np.full(len(bodies), margin_m)
        keep[num_pieces] = min_height_m
        kind = np.full(len(bodies), Kind.FENCE, dtype=np.int64)
        kind[:num_pieces], kind[num_pieces] = Kind.OBSTACLE, Kind.GROUND
        return cls(normal, offset, keep, kind)

    def around(self, place_enu_m: FloatArray, reach_m: float) -> "Hazards":
        """Return the hazards within reach of a vertical line, beyond what is to be kept.

        Args:
            place_enu_m: Where the line stands, shape ``(2,)``.
            reach_m: How far.
        """
        upright = self.normal[..., 2] == 0.0
        beside_m = self.normal[..., :2] @ place_enu_m - self.offset_m
        return self.take(np.where(upright, beside_m, -np.inf).max(axis=1) - self.keep_m < reach_m)

    def plane_distance_m(self, position_enu_m: FloatArray) -> FloatArray:
        """Return the distance of one point ``(3,)`` to every plane, ``(B, F)``; -inf at padding."""
        return np.asarray(self.normal @ position_enu_m - self.offset_m)

    def take(self, rows: BoolArray) -> "Hazards":
        """Return some of the hazards."""
        return Hazards(self.normal[rows], self.offset_m[rows], self.keep_m[rows], self.kind[rows])


class HazardSquares:
    """What is near a place, looked up once for every square of the map: its streets first.

    Args:
        hazards: Of the whole map.
        reach_m: How near is near, beyond what is to be kept.
    """

    def __init__(self, hazards: Hazards, reach_m: float) -> None:
        self._hazards = hazards
        self._reach_m = reach_m
        self._in_square = lru_cache(maxsize=_NUM_SQUARES)(self._of_square)
        self._in_block = lru_cache(maxsize=_NUM_BLOCKS)(self._of_block)

    def around(self, position_enu_m: FloatArray) -> Hazards:
        """Return at least the hazards within reach of a point, ``(3,)``."""
        east_m, north_m = position_enu_m[:2].tolist()
        return self._in_square(math.floor(east_m / _SQUARE_M), math.floor(north_m / _SQUARE_M))

    def _of_square(self, east: int, north: int) -> Hazards:
        block = self._in_block(east // _SQUARES_A_BLOCK, north // _SQUARES_A_BLOCK)
        return self._of(block, east, north, _SQUARE_M)

    def _of_block(self, east: int, north: int) -> Hazards:
        return self._of(self._hazards, east, north, _SQUARE_M * _SQUARES_A_BLOCK)

    def _of(self, hazards: Hazards, east: int, north: int, side_m: float) -> Hazards:
        middle_m = side_m * np.array([east + 0.5, north + 0.5])
        return hazards.around(middle_m, self._reach_m + math.sqrt(0.5) * side_m)


def crossing(outside_m: FloatArray, change_m: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Follow straight ways into bodies.

    Args:
        outside_m: Distance of each start to each plane of each body, ``(..., B, F)``.
        change_m: Of that distance, from start to end.

    Returns:
        The share of each way before it enters each body, and whether it enters it at all,
        ``(..., B)`` each; a way that only touches a face does not.
    """
    # Along a plane, dividing by zero gives +inf in front of it: never in; -inf behind it: no limit;
    # nan on it, which fmax skips: no limit either.
    end_m = outside_m + change_m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before = np.fmax.reduce(outside_m / np.maximum(-change_m, 0.0), axis=-1, initial=0.0)
        after = np.fmax.reduce(end_m / np.maximum(change_m, 0.0), axis=-1, initial=0.0)
    return before, np.asarray(before + after < 1.0)


def _prism_planes(ring_m: FloatArray, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the planes of a prism over a convex counter-clockwise ring ``(V, 2)``.

    Walls, one plane across every vertical edge, the roof, and planes across the edges between
    walls and roof: along these a vehicle that has come up to the roof slides over it.
    """
    along = np.roll(ring_m, -1, axis=0) - ring_m
    wall = np.column_stack((along[:, 1], -along[:, 0]))
    wall /= np.sqrt((wall**2).sum(axis=1, keepdims=True))
    across = wall + np.roll(wall, 1, axis=0)  # at the start of each edge
    across /= np.maximum(np.sqrt((across**2).sum(axis=1, keepdims=True)), 1e-9)
    flat, corner_m = np.concatenate((wall, across)), np.concatenate((ring_m, ring_m))
    planes = [np.column_stack((flat, np.zeros(len(flat)))), np.array([[0.0, 0.0, 1.0]])]
    points = [np.column_stack((corner_m, np.zeros(len(flat)))), np.array([[0.0, 0.0, height_m]])]
    for slope_rad in _EAVES_RAD:
        upward = np.full(len(wall), np.sin(slope_rad))
        planes.append(np.column_stack((np.cos(slope_rad) * wall, upward)))
        points.append(np.column_stack((ring_m, np.full(len(wall), height_m))))
    normal = np.concatenate(planes)
    return normal, (normal * np.concatenate(points)).sum(axis=1)
