"""Map ENU, local NED and WGS84: the only conversions between them.

Placeholder signatures; the world module completes them.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A point on or above the WGS84 ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above mean sea level."""
