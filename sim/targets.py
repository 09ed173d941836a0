"""Where a target goes: random trajectories, fixed in advance, that the vehicle does not know.

Every trajectory is a closed polyline flown at constant speed, so position is a function of
time alone, and "never inside an obstacle" is proved edge by edge when it is drawn. A straight
run is a polyline of two vertices (there and back), a circle one of 24, a tour of random
waypoints one of five. Short ones repeat their first vertex.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from companion.world.maps import Map
from sim.sampling import MapUnder, sample_free_under

VERTICES = 24
"""A circle of 24 chords is nowhere more than 0.9 % of its radius off."""

_WAYPOINTS = 5
_REACH = (0.05, 0.25)
"""Radius of circles, and half the length of runs and tours, as fractions of the edge."""
_TRIES = 4
"""Candidates for each path at once; about one in three has room."""
_ROUNDS = 15


class TargetMotion(StrEnum):
    """What the targets of a world do."""

    STATIC = "static"
    MOVING = "moving"


@dataclass(frozen=True, slots=True)
class TargetPaths:
    """``N`` closed polylines, each with the speed of the target on it."""

    vertex_enu_m: FloatArray  # (N, K, 3)
    """Corners; the last is joined to the first."""
    arc_m: FloatArray  # (N, K + 1)
    """Length of the way from the first corner to each; the last entry is the whole length."""
    speed_mps: FloatArray  # (N,)

    @classmethod
    def through(cls, vertex_enu_m: FloatArray, speed_mps: FloatArray) -> "TargetPaths":
        """Measure closed polylines given by their corners, shape ``(N, K, 3)``."""
        edge_m = np.linalg.norm(np.roll(vertex_enu_m, -1, axis=1) - vertex_enu_m, axis=-1)
        arc_m = np.concatenate((np.zeros((len(edge_m), 1)), np.cumsum(edge_m, axis=1)), axis=1)
        return cls(vertex_enu_m, arc_m, speed_mps)

    @classmethod
    def resting(cls, position_enu_m: FloatArray) -> "TargetPaths":
        """Return paths that stay at ``position_enu_m``, shape ``(N, 3)``."""
        return cls.through(position_enu_m[:, None, :], np.zeros(len(position_enu_m)))

    @classmethod
    def unset(cls, count: int) -> "TargetPaths":
        """Return room for ``count`` moving targets, to be filled by ``put``."""
        return cls.through(np.zeros((count, VERTICES, 3)), np.zeros(count))

    def take(self, rows: IntArray) -> "TargetPaths":
        """Return some of the paths."""
        return TargetPaths(self.vertex_enu_m[rows], self.arc_m[rows], self.speed_mps[rows])

    def put(self, rows: IntArray | slice, paths: "TargetPaths") -> None:
        """Overwrite ``rows`` with other paths of as many corners."""
        self.vertex_enu_m[rows] = paths.vertex_enu_m
        self.arc_m[rows] = paths.arc_m
        self.speed_mps[rows] = paths.speed_mps

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the targets are and how fast they go.

        Args:
            time_s: Time since the start of each path, shape ``(N,)``.

        Returns:
            ``position_enu_m`` and ``velocity_enu_mps``, shapes ``(N, 3)``.
        """
        num_vertices = self.vertex_enu_m.shape[1]
        if num_vertices == 1:
            first_enu_m = self.vertex_enu_m[:, 0]
            return first_enu_m.copy(), np.zeros_like(first_enu_m)
        rows = np.arange(len(self.vertex_enu_m))
        length_m = self.arc_m[:, -1]
        covered_m = np.mod(self.speed_mps * time_s, np.where(length_m > 0.0, length_m, np.inf))

        edge = np.sum(self.arc_m[:, 1:-1] <= covered_m[:, None], axis=1)
        from_enu_m = self.vertex_enu_m[rows, edge]
        along_enu_m = self.vertex_enu_m[rows, (edge + 1) % num_vertices] - from_enu_m
        edge_m = self.arc_m[rows, edge + 1] - self.arc_m[rows, edge]
        unit_enu = along_enu_m / np.where(edge_m > 0.0, edge_m, 1.0)[:, None]
        position_enu_m = from_enu_m + unit_enu * (covered_m - self.arc_m[rows, edge])[:, None]
        return position_enu_m, unit_enu * self.speed_mps[:, None]


def random_paths(
    city: Map, rng: np.random.Generator, count: int, *, speed_mps: tuple[float, float]
) -> TargetPaths:
    """Draw trajectories that stay inside the map and outside its obstacles.

    Straight runs, circles and tours are equally likely before rejection. A path for which no
    room was found in 60 draws rests at a free point.

    Args:
        city: The map.
        rng: Source of randomness.
        count: How many paths.
        speed_mps: Least and largest speed, drawn uniformly.

    Raises:
        MapError: If the map has next to no free space.
    """
    return random_paths_under(lambda _: city, rng, np.arange(count), speed_mps=speed_mps)


def random_paths_under(
    map_under: MapUnder, rng: np.random.Generator, rows: IntArray, *, speed_mps: tuple[float, float]
) -> TargetPaths:
    """Draw a trajectory for each of ``rows``, as ``random_paths`` does for one map."""
    vertex_enu_m = np.empty((len(rows), VERTICES, 3))
    missing: IntArray = np.arange(len(rows))
    for _ in range(_ROUNDS):
        if len(missing) == 0:
            break
        tried = np.repeat(rows[missing], _TRIES)
        start_enu_m = sample_free_under(map_under, rng, tried)
        candidates = _paths_from(start_enu_m, map_under(tried).edge_m, rng)
        clear = _stay_clear(map_under(np.repeat(tried, VERTICES)), candidates)
        clear = clear.reshape(-1, _TRIES)
        first = np.argmax(clear, axis=1) + np.arange(len(missing)) * _TRIES
        found = np.any(clear, axis=1)
        vertex_enu_m[missing[found]] = candidates[first[found]]
        missing = missing[~found]
    vertex_enu_m[missing] = sample_free_under(map_under, rng, rows[missing])[:, None, :]
    return TargetPaths.through(vertex_enu_m, rng.uniform(*speed_mps, len(rows)))


def _stay_clear(city: Map, vertex_enu_m: FloatArray) -> BoolArray:
    """Return which closed polylines ``(N, K, 3)`` stay in the map and cross no obstacle."""
    start_enu_m = vertex_enu_m.reshape(-1, 3)
    end_enu_m = np.roll(vertex_enu_m, -1, axis=1).reshape(-1, 3)
    clear = city.obstacles.crash_depth_m(start_enu_m, end_enu_m) == 0.0
    clear &= city.contains(start_enu_m)
    whole: BoolArray = np.all(clear.reshape(vertex_enu_m.shape[:2]), axis=1)
    return whole


def _paths_from(start_enu_m: FloatArray, edge_m: float, rng: np.random.Generator) -> FloatArray:
    """Return random polylines from free points ``(N, 3)``, shape ``(N, VERTICES, 3)``."""
    count = len(start_enu_m)
    reach_m = rng.uniform(*_REACH, count) * edge_m
    kind = rng.integers(3, size=count)

    vertex_enu_m = np.repeat(start_enu_m[:, None, :], VERTICES, axis=1)
    run = kind == 0
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    vertex_enu_m[run, 1] += (direction * 2.0 * reach_m[:, None])[run]

    circle = kind == 1
    turn_rad = np.linspace(0.0, 2.0 * np.pi, VERTICES, endpoint=False)
    angle_rad = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + turn_rad
    ring = np.stack((np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)), axis=-1)
    vertex_enu_m[circle] += ((ring - ring[:, :1]) * reach_m[:, None, None])[circle]

    tour = kind == 2
    offset_m = rng.uniform(-1.0, 1.0, (count, _WAYPOINTS - 1, 3)) * reach_m[:, None, None]
    vertex_enu_m[tour, 1:_WAYPOINTS] += offset_m[tour]
    return vertex_enu_m
