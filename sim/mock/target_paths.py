"""The ways that targets go: paths inside the map that never touch an obstacle."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from companion.arrays import FloatArray
from sim.mock.placement import Place
from sim.mock.specs import Spec
from sim.mock.target_tracks import read_track

MARGIN_M = 2.0
"""Distance that a target keeps from obstacles and from the border of the map."""
TRIES = 5000

Path = Callable[[float], FloatArray]
"""Position in the map, shape ``(3,)``, by time."""


@dataclass(frozen=True, slots=True)
class Course:
    """Where targets may go."""

    place: Place
    rng: np.random.Generator

    def free(self, points: FloatArray) -> bool:
        """Return whether the points, and the straight lines between them, are free."""
        map_ = self.place.map
        if map_ is None:
            return True
        inside = (points >= MARGIN_M) & (points <= np.asarray(map_.size_m) - MARGIN_M)
        if not inside.all() or not map_.is_free(points, MARGIN_M).all():
            return False
        # Lines are walked in steps of a metre: the margin holds along them, not only no crash.
        return all(
            bool(map_.is_free(np.linspace(a, b, 2 + int(np.linalg.norm(b - a))), MARGIN_M).all())
            for a, b in pairwise(points)
        )

    def random_point(self) -> FloatArray:
        """Return a random point: anywhere in the map, or within 50 m of the launch."""
        map_ = self.place.map
        if map_ is None:
            return self.rng.uniform([-50.0, -50.0, 5.0], [50.0, 50.0, 25.0])
        size = np.asarray(map_.size_m, dtype=np.float64)
        return self.rng.uniform(np.full(3, MARGIN_M), np.maximum(size - MARGIN_M, MARGIN_M))

    def search(self, spec: Spec, build: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return points built around a random one such that they are free.

        Raises:
            UsageError: If none were found.
        """
        for _ in range(TRIES):
            points = build(self.random_point())
            if self.free(points):
                return points
        raise spec.error("found no free place for this target on the map")

    def given(self, spec: Spec, points: FloatArray) -> FloatArray:
        """Return points that the user chose, if they are free."""
        if not self.free(points):
            raise spec.error(
                f"its path leaves the map or comes within {MARGIN_M:g} m of an obstacle"
            )
        return points


def _static(spec: Spec, course: Course, speed_mps: float) -> Path:
    at = spec.point("at")
    build = np.atleast_2d
    point = course.search(spec, build) if at is None else course.given(spec, build(np.array(at)))
    return lambda time_s: point[0]


def _straight(spec: Spec, course: Course, speed_mps: float) -> Path:
    start, end = spec.point("at"), spec.point("to")
    if (start is None) != (end is None):
        raise spec.error("a straight path needs both at and to, or neither")
    if start is not None and end is not None:
        points = course.given(spec, np.array([start, end]))
    else:
        other = course.random_point
        points = course.search(spec, lambda point: np.array([point, other()]))
    length = max(float(np.linalg.norm(points[1] - points[0])), 1e-9)

    def path(time_s: float) -> FloatArray:
        share = time_s * speed_mps / length % 2.0  # there and back again
        share = min(share, 2.0 - share)
        here: FloatArray = points[0] + share * (points[1] - points[0])
        return here

    return path


def _circle(spec: Spec, course: Course, speed_mps: float) -> Path:
    radius = spec.number("radius", 10.0, low=0.1)
    turns = np.linspace(0.0, 2.0 * np.pi, 73)
    ring = radius * np.stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)], axis=1)
    at = spec.point("at")
    points = (
        course.search(spec, lambda centre: centre + ring)
        if at is None
        else course.given(spec, np.array(at) + ring)
    )
    centre = points[0] - ring[0]

    def path(time_s: float) -> FloatArray:
        angle = time_s * speed_mps / radius
        here: FloatArray = centre + radius * np.array([math.cos(angle), math.sin(angle), 0.0])
        return here

    return path


def _waypoints(spec: Spec, course: Course, speed_mps: float) -> Path:
    at = spec.point("at")
    if at is None:
        points: list[FloatArray] = [course.search(spec, np.atleast_2d)[0]]
    else:
        points = [course.given(spec, np.atleast_2d(np.array(at)))[0]]
    arrivals_s = [0.0]

    def path(time_s: float) -> FloatArray:
        while speed_mps > 0.0 and arrivals_s[-1] <= time_s:
            last = points[-1]
            there = course.search(spec, partial(_leg, last))[1]
            arrivals_s.append(arrivals_s[-1] + float(np.linalg.norm(there - last)) / speed_mps)
            points.append(there)
        leg = int(np.searchsorted(arrivals_s, time_s, side="right"))
        if leg >= len(points):
            return points[-1]
        share = (time_s - arrivals_s[leg - 1]) / (arrivals_s[leg] - arrivals_s[leg - 1])
        here: FloatArray = points[leg - 1] + share * (points[leg] - points[leg - 1])
        return here

    return path


def _recorded(spec: Spec, course: Course, speed_mps: float) -> Path:
    """Return the way of a file, once through; it begins at ``at`` if that is given."""
    name = spec.word("file")
    if name is None:
        raise spec.error("a recorded path needs file=TRACK.csv or file=FLIGHT.tlog")
    times_s, points = read_track(spec, name)
    at = spec.point("at")
    if at is not None:
        points = points - points[0] + np.array(at)
    points = course.given(spec, points)

    def path(time_s: float) -> FloatArray:
        here = [np.interp(time_s, times_s, points[:, axis]) for axis in range(3)]
        return np.array(here, dtype=np.float64)

    return path


def _leg(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.array([start, end])


PATHS: dict[str, Callable[[Spec, Course, float], Path]] = {
    "static": _static,
    "straight": _straight,
    "circle": _circle,
    "waypoints": _waypoints,
    "recorded": _recorded,
}
KEYS = ("at", "to", "radius", "file")
"""Keys of a specification that only paths read."""
