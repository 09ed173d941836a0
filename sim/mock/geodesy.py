"""Local NED to latitude and longitude exactly as the autopilots do it.

ArduPilot multiplies differences of latitude and longitude by one constant, as on a sphere of
6378.1 km, and shortens the east by the cosine of the mean latitude (``Location.cpp``).

PX4's ``MapProjection`` is an azimuthal equidistant projection of a *sphere* of 6371 km. The
recorded flights confirm it: at 17 m east of the origin GLOBAL_POSITION_INT and
LOCAL_POSITION_NED agree to 5 mm on the sphere and are 42 mm apart on the ellipsoid (0.3 % at
47 degrees north). A companion that ties its map by WGS84 meets the same difference on a real
vehicle.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

from companion.world.frames import GeoPoint

EARTH_RADIUS_M = 6371000.0


METRES_PER_DEGREE = 0.011131884502145034 * 1e7
"""ArduPilot's LATLON_TO_M, per degree."""


@dataclass(frozen=True)
class Projection(ABC):
    """A projection around one reference point."""

    reference: GeoPoint

    @abstractmethod
    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return latitude and longitude in degrees."""

    @abstractmethod
    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return north and east in metres."""


class FlatProjection(Projection):
    """ArduPilot's."""

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return latitude and longitude in degrees."""
        climb_deg = north_m / METRES_PER_DEGREE
        scale = self._longitude_scale(self.reference.latitude_deg + climb_deg / 2.0)
        turn_deg = east_m / METRES_PER_DEGREE / scale
        return self.reference.latitude_deg + climb_deg, self.reference.longitude_deg + turn_deg

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return north and east in metres."""
        climb_deg = latitude_deg - self.reference.latitude_deg
        scale = self._longitude_scale(self.reference.latitude_deg + climb_deg / 2.0)
        turn_deg = (longitude_deg - self.reference.longitude_deg + 180.0) % 360.0 - 180.0
        return climb_deg * METRES_PER_DEGREE, turn_deg * METRES_PER_DEGREE * scale

    @staticmethod
    def _longitude_scale(latitude_deg: float) -> float:
        return max(0.01, math.cos(math.radians(latitude_deg)))


class SphericalProjection(Projection):
    """PX4's."""

    @cached_property
    def _reference(self) -> tuple[float, float, float]:
        """Sine and cosine of the latitude, and the longitude in radians."""
        latitude_rad = math.radians(self.reference.latitude_deg)
        longitude_rad = math.radians(self.reference.longitude_deg)
        return math.sin(latitude_rad), math.cos(latitude_rad), longitude_rad

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return latitude and longitude in degrees."""
        sin_latitude, cos_latitude, longitude_rad = self._reference
        x, y = north_m / EARTH_RADIUS_M, east_m / EARTH_RADIUS_M
        arc = math.hypot(x, y)
        if arc == 0.0:
            return self.reference.latitude_deg, self.reference.longitude_deg
        sin_arc, cos_arc = math.sin(arc), math.cos(arc)
        latitude = math.asin(cos_arc * sin_latitude + x * sin_arc * cos_latitude / arc)
        longitude = longitude_rad + math.atan2(
            y * sin_arc, arc * cos_latitude * cos_arc - x * sin_latitude * sin_arc
        )
        return math.degrees(latitude), math.degrees(longitude)

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return north and east in metres."""
        reference_rad = math.radians(self.reference.latitude_deg)
        latitude = math.radians(latitude_deg)
        turn = math.radians(longitude_deg - self.reference.longitude_deg)
        cos_arc = math.sin(reference_rad) * math.sin(latitude) + math.cos(reference_rad) * math.cos(
            latitude
        ) * math.cos(turn)
        arc = math.acos(max(-1.0, min(1.0, cos_arc)))
        scale = EARTH_RADIUS_M * (arc / math.sin(arc) if arc > 1e-9 else 1.0)
        north = math.cos(reference_rad) * math.sin(latitude) - math.sin(reference_rad) * math.cos(
            latitude
        ) * math.cos(turn)
        return scale * north, scale * math.cos(latitude) * math.sin(turn)
