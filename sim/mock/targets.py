"""Other systems that report their position: something to pursue.

A target is a beacon of its own system id. It moves along a path inside the map that never
touches an obstacle, and sends HEARTBEAT and GLOBAL_POSITION_INT or FOLLOW_TARGET.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.arrays import FloatArray
from sim.mock.placement import Place
from sim.mock.specs import Spec

SPEED_MPS = 2.0
MARGIN_M = 2.0
"""Distance that a target keeps from obstacles and from the border of the map."""
CLOCK_LEAD_S = 100.0
"""Targets were switched on earlier than the vehicle: their clocks differ."""
TRIES = 5000
ALLOWED = dict.fromkeys(
    ("kind", "sysid", "message", "rate", "speed", "at", "to", "radius", "autopilot")
)
MESSAGES = {"gpi": 5.0, "follow": 4.0}
"""Words for the message, with its default rate in Hz."""
AUTOPILOTS = {"none": mavlink.MAV_AUTOPILOT_INVALID, "px4": mavlink.MAV_AUTOPILOT_PX4}

Path = Callable[[float], FloatArray]
"""Position in the map, shape ``(3,)``, by time."""


@dataclass(slots=True)
class Target:
    """One beacon: where it is and what it sends."""

    sysid: int
    path: Path
    place: Place
    message: str
    rate_hz: float
    autopilot: int
    silent: bool = False
    """A fault: nothing is sent."""
    frozen_s: float | None = None
    """A fault: the report of this moment is repeated for ever."""
    jump_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _codec: Any = None
    _due_s: float = 0.0
    _heartbeat_due_s: float = 0.0

    def tick(self, now_s: float) -> list[bytes]:
        """Return the packets that are due."""
        if self._codec is None:
            self._codec = mavlink.MAVLink(None, srcSystem=self.sysid, srcComponent=1)
        packets = []
        if now_s >= self._heartbeat_due_s - 1e-9:
            self._heartbeat_due_s += 1.0
            packets.append(self._heartbeat())
        if now_s >= self._due_s - 1e-9:
            self._due_s += 1.0 / self.rate_hz
            packets.append(self._report(now_s if self.frozen_s is None else self.frozen_s))
        return [] if self.silent else [self._pack(message) for message in packets]

    def position_enu_m(self, now_s: float) -> FloatArray:
        """Return where it says it is."""
        position_enu_m: FloatArray = self.path(now_s) + np.asarray(self.jump_enu_m)
        return position_enu_m

    def _pack(self, message: Any) -> bytes:
        packet: bytes = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        return packet

    def _heartbeat(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, self.autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def _report(self, time_s: float) -> Any:
        here = self.position_enu_m(time_s)
        east, north, up = (self.position_enu_m(time_s + 0.05) - here) / 0.05
        velocity_ned = (float(north), float(east), -float(up))
        point = self.place.to_geodetic(here)
        latitude, longitude = round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7)
        clock_ms = round((time_s + CLOCK_LEAD_S) * 1e3)
        if self.message == "follow":
            return mavlink.MAVLink_follow_target_message(
                clock_ms, 0b11, latitude, longitude, point.altitude_m, velocity_ned,
                (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, 0,
            )  # fmt: skip
        relative_m = point.altitude_m - self.place.home.altitude_m
        centimetres = (round(value * 100.0) for value in velocity_ned)
        course = math.degrees(math.atan2(velocity_ned[1], velocity_ned[0])) % 360.0
        return mavlink.MAVLink_global_position_int_message(
            clock_ms,
            latitude,
            longitude,
            round(point.altitude_m * 1e3),
            round(relative_m * 1e3),
            *centimetres,
            round(course * 100.0) % 36000,
        )


def parse_target(text: str, place: Place, rng: np.random.Generator) -> Target:
    """Build a target from ``kind=circle,sysid=42,...``.

    Raises:
        UsageError: If the specification makes no sense, or its path touches an obstacle.
    """
    spec = Spec("--target", text)
    spec.check_keys(ALLOWED)
    kind = spec.choice("kind", _PATHS, "waypoints")
    message = spec.choice("message", MESSAGES, "gpi")
    sysid = int(spec.number("sysid", 42.0, low=2.0))
    if sysid > 255:
        raise spec.error("sysid must lie in 2..255")
    path = _PATHS[kind](spec, _Course(place, rng), spec.number("speed", SPEED_MPS, low=0.0))
    return Target(
        sysid=sysid,
        path=path,
        place=place,
        message=message,
        rate_hz=max(0.1, spec.number("rate", MESSAGES[message], low=0.1)),
        autopilot=AUTOPILOTS[spec.choice("autopilot", AUTOPILOTS, "none")],
    )


@dataclass(frozen=True, slots=True)
class _Course:
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


def _static(spec: Spec, course: _Course, speed_mps: float) -> Path:
    at = spec.point("at")
    build = np.atleast_2d
    point = course.search(spec, build) if at is None else course.given(spec, build(np.array(at)))
    return lambda time_s: point[0]


def _straight(spec: Spec, course: _Course, speed_mps: float) -> Path:
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


def _circle(spec: Spec, course: _Course, speed_mps: float) -> Path:
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


def _waypoints(spec: Spec, course: _Course, speed_mps: float) -> Path:
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


def _leg(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.array([start, end])


_PATHS: dict[str, Callable[[Spec, _Course, float], Path]] = {
    "static": _static,
    "straight": _straight,
    "circle": _circle,
    "waypoints": _waypoints,
}
