"""Other systems that report their position: something to pursue.

A target is a beacon of its own system id. It moves along a path of ``target_paths`` and sends
HEARTBEAT and GLOBAL_POSITION_INT or FOLLOW_TARGET. A telephone that hands out its position four
times a second has a new one only once a second: ``repeat`` says each report so many times.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.arrays import FloatArray
from sim.mock.dynamics import ZERO, Vector
from sim.mock.placement import Place
from sim.mock.specs import Spec
from sim.mock.target_paths import KEYS, PATHS, Course, Path

SPEED_MPS = 2.0
CLOCK_LEAD_S = 100.0
"""Targets were switched on earlier than the vehicle: their clocks differ."""
ALLOWED = dict.fromkeys(
    ("kind", "sysid", "message", "rate", "speed", "repeat", "drop", "autopilot", *KEYS)
)
MESSAGES = {"gpi": 5.0, "follow": 4.0}
"""Words for the message, with its default rate in Hz."""
AUTOPILOTS = {"none": mavlink.MAV_AUTOPILOT_INVALID, "px4": mavlink.MAV_AUTOPILOT_PX4}


@dataclass(slots=True)
class Target:
    """One beacon: where it is and what it sends."""

    sysid: int
    path: Path
    place: Place
    message: str
    rate_hz: float
    autopilot: int
    repeat: int = 1
    """How often each report is sent before there is a new one."""
    drop: float = 0.0
    """Share of the reports that are never sent."""
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    silent: bool = False
    """A fault: nothing is sent."""
    frozen_s: float | None = None
    """A fault: the report of this moment is repeated for ever."""
    jump_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    double_enu_m: tuple[float, float, float] | None = None
    """A fault: so far away another system uses the same id."""
    _codec: Any = None
    _due_s: float = 0.0
    _heartbeat_due_s: float = 0.0
    _reports: int = 0
    _known_s: float = 0.0

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
            if self._reports % self.repeat == 0:
                self._known_s = now_s
            self._reports += 1
            if self.drop == 0.0 or self.rng.random() >= self.drop:
                known_s = self._known_s if self.frozen_s is None else self.frozen_s
                packets.append(self._report(known_s))
                if self.double_enu_m is not None:
                    packets.append(self._report(known_s, self.double_enu_m))
        return [] if self.silent else [self._pack(message) for message in packets]

    def position_enu_m(self, now_s: float, offset_m: Vector = ZERO) -> FloatArray:
        """Return where it says it is."""
        offset: FloatArray = np.asarray(self.jump_enu_m) + np.asarray(offset_m)
        return self.path(now_s) + offset

    def _pack(self, message: Any) -> bytes:
        packet: bytes = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        return packet

    def _heartbeat(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, self.autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def _report(self, time_s: float, offset_m: Vector = ZERO) -> Any:
        here = self.position_enu_m(time_s, offset_m)
        east, north, up = (self.position_enu_m(time_s + 0.05, offset_m) - here) / 0.05
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
    kind = spec.choice("kind", PATHS, "waypoints")
    message = spec.choice("message", MESSAGES, "gpi")
    sysid = int(spec.number("sysid", 42.0, low=2.0))
    if sysid > 255:
        raise spec.error("sysid must lie in 2..255")
    drop_percent = spec.number("drop", 0.0, low=0.0)
    if drop_percent > 100.0:
        raise spec.error("drop is a share in percent")
    path = PATHS[kind](spec, Course(place, rng), spec.number("speed", SPEED_MPS, low=0.0))
    return Target(
        sysid=sysid,
        path=path,
        place=place,
        message=message,
        rate_hz=max(0.1, spec.number("rate", MESSAGES[message], low=0.1)),
        autopilot=AUTOPILOTS[spec.choice("autopilot", AUTOPILOTS, "none")],
        repeat=max(1, int(spec.number("repeat", 1.0, low=1.0))),
        drop=drop_percent / 100.0,
        rng=rng,
    )
