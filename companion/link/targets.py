"""Targets as they come over MAVLink: positions of other systems, checked and in SI units."""

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from companion.arrays import FloatArray
from companion.vehicle import TargetReport
from companion.world.frames import GeoPoint

_HAS_POSITION = 1 << 0
_HAS_VELOCITY = 1 << 1


class Targets:
    """The newest report of every system that was named as a target; nobody else is heard."""

    def __init__(self, system_ids: Iterable[int]) -> None:
        self.system_ids = frozenset(system_ids)
        self._reports: dict[int, TargetReport] = {}

    def reports(self) -> Mapping[int, TargetReport]:
        """Return the newest report by system id; a copy."""
        return MappingProxyType(dict(self._reports))

    def global_position(self, message: Any, system_id: int, now_s: float) -> None:
        """Take in GLOBAL_POSITION_INT; one without a place is ignored."""
        position = geo_point(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        if position is None:
            return
        self._reports[system_id] = TargetReport(
            time_s=now_s,
            system_id=system_id,
            source="GLOBAL_POSITION_INT",
            position=position,
            velocity_ned_mps=_frozen(np.array((message.vx, message.vy, message.vz)) * 1e-2),
            source_time_s=message.time_boot_ms * 1e-3,
        )

    def follow_target(self, message: Any, system_id: int, now_s: float) -> None:
        """Take in FOLLOW_TARGET; one without a place is ignored."""
        position = geo_point(message.lat * 1e-7, message.lon * 1e-7, message.alt)
        if position is None or not message.est_capabilities & _HAS_POSITION:
            return
        velocity_ned_mps = None
        if message.est_capabilities & _HAS_VELOCITY and all(map(math.isfinite, message.vel)):
            velocity_ned_mps = _frozen(np.array(message.vel, dtype=np.float64))
        self._reports[system_id] = TargetReport(
            time_s=now_s,
            system_id=system_id,
            source="FOLLOW_TARGET",
            position=position,
            velocity_ned_mps=velocity_ned_mps,
            source_time_s=message.timestamp * 1e-3,
        )


def geo_point(latitude_deg: float, longitude_deg: float, altitude_m: float) -> GeoPoint | None:
    """Return the point, or ``None`` if it is no place: not finite, off the globe, or (0, 0).

    (0, 0) is what autopilots send before their first fix.
    """
    if not math.isfinite(latitude_deg + longitude_deg + altitude_m):
        return None
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
        return None
    if latitude_deg == 0.0 and longitude_deg == 0.0:
        return None
    return GeoPoint(latitude_deg, longitude_deg, altitude_m)


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
