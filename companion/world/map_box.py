"""Where an imported map lies: a box on earth, and its tangent plane."""

import math
from dataclasses import dataclass, field

import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world.frames import GeoPoint, enu_to_geodetic, geodetic_to_enu, ground_to_enu
from companion.world.maps import MAX_SIDE_M

GRID_M = 0.01
"""Maps are written to the centimetre: finer than any survey, coarser than rounding."""
_MIN_SIDE_M = 10.0
_EARTH_M = 6_371_000.0
_LAST_LATITUDE_DEG = 85.0
_DEGREE_DIGITS = 8
"""Of latitude and longitude: a millimetre."""


@dataclass(frozen=True, slots=True)
class MapBox:
    """The ground of a map."""

    origin: GeoPoint
    """The south-west corner."""
    east_m: float
    north_m: float
    bounds_deg: tuple[FloatArray, FloatArray] = field(init=False, repr=False, compare=False)
    """The least and the largest longitude and latitude, ``(2,)`` each."""

    def __post_init__(self) -> None:
        bounds_deg = _bounds_deg(self.origin, self.east_m, self.north_m)
        object.__setattr__(self, "bounds_deg", bounds_deg)

    @classmethod
    def between(
        cls, first_deg: tuple[float, float], second_deg: tuple[float, float], altitude_m: float
    ) -> "MapBox":
        """Return the box of two opposite corners, ``(latitude, longitude)`` in any order.

        The smallest box over all four corners: the meridians draw together toward the poles, some
        centimetres in a kilometre.
        """
        south, north = sorted((first_deg[0], second_deg[0]))
        west, east = sorted((first_deg[1], second_deg[1]))
        _check_span(west, south, east, north)
        corners_m = ground_to_enu(
            _origin(south, west, altitude_m),
            latitude_deg=np.array([south, north, north]),
            longitude_deg=np.array([east, west, east]),
        )
        return cls._of(_origin(south, west, altitude_m), corners_m.max(axis=0))

    @classmethod
    def around(cls, center_deg: tuple[float, float], size_m: float, altitude_m: float) -> "MapBox":
        """Return the square with its middle at ``(latitude, longitude)``."""
        center = GeoPoint(*center_deg, altitude_m)
        middle_m = np.array([0.5 * size_m, 0.5 * size_m, 0.0])
        corner_m = -middle_m
        # The axes at the corner are turned against those at the middle, by little.
        for _ in range(3):
            corner = enu_to_geodetic(center, corner_m)
            corner = GeoPoint(corner.latitude_deg, corner.longitude_deg, altitude_m)
            corner_m = corner_m + (geodetic_to_enu(corner, center) - middle_m) * (1.0, 1.0, 0.0)
        origin = _origin(corner.latitude_deg, corner.longitude_deg, altitude_m)
        return cls._of(origin, np.array([size_m, size_m]))

    @classmethod
    def over(cls, places_deg: FloatArray, spare_m: float, altitude_m: float) -> "MapBox":
        """Return the box over places ``(N, 2)``, longitude and latitude, and a bit more."""
        west, south = places_deg.min(axis=0).tolist()
        east, north = places_deg.max(axis=0).tolist()
        _check_span(west, south, east, north)
        low = _origin(south, west, altitude_m)
        places_m = ground_to_enu(low, places_deg[:, 1], places_deg[:, 0])
        corner = enu_to_geodetic(low, np.append(places_m.min(axis=0) - spare_m, 0.0))
        origin = _origin(corner.latitude_deg, corner.longitude_deg, altitude_m)
        places_m = ground_to_enu(origin, places_deg[:, 1], places_deg[:, 0])
        return cls._of(origin, np.ceil(places_m.max(axis=0) + spare_m))

    @classmethod
    def _of(cls, origin: GeoPoint, size_m: FloatArray) -> "MapBox":
        _check_size(size_m)
        east_m, north_m = np.round(np.ceil(np.round(size_m / GRID_M, 3)) * GRID_M, 2).tolist()
        box = cls(origin, east_m, north_m)
        low_deg, high_deg = box.bounds_deg
        _check_latitude(float(high_deg[1]))
        if high_deg[0] - low_deg[0] > 180.0:
            raise MapError(_ANTIMERIDIAN)
        return box


def _bounds_deg(origin: GeoPoint, east_m: float, north_m: float) -> tuple[FloatArray, FloatArray]:
    corners = [
        enu_to_geodetic(origin, np.array([east, north, 0.0]))
        for east in (0.0, east_m)
        for north in (0.0, north_m)
    ]
    places_deg = np.array([(point.longitude_deg, point.latitude_deg) for point in corners])
    return places_deg.min(axis=0), places_deg.max(axis=0)


_ANTIMERIDIAN = "the box crosses the antimeridian (180 degrees east): choose one to a side of it"


def _origin(latitude_deg: float, longitude_deg: float, altitude_m: float) -> GeoPoint:
    _check_latitude(latitude_deg)
    return GeoPoint(
        round(float(latitude_deg), _DEGREE_DIGITS),
        round(float(longitude_deg), _DEGREE_DIGITS),
        altitude_m,
    )


def _check_latitude(latitude_deg: float) -> None:
    if not abs(latitude_deg) <= _LAST_LATITUDE_DEG:
        raise MapError(
            f"the box reaches latitude {latitude_deg:.3f}: maps end at {_LAST_LATITUDE_DEG:g} "
            "degrees, nearer to the poles the axes turn too fast"
        )


def _check_span(west_deg: float, south_deg: float, east_deg: float, north_deg: float) -> None:
    """Refuse what no plane can touch, before laying one."""
    if east_deg - west_deg > 180.0:
        raise MapError(_ANTIMERIDIAN)
    lowest_deg = min(abs(south_deg), abs(north_deg)) if south_deg * north_deg > 0.0 else 0.0
    east_rad, north_rad = math.radians(east_deg - west_deg), math.radians(north_deg - south_deg)
    size_m = _EARTH_M * np.array([east_rad * math.cos(math.radians(lowest_deg)), north_rad])
    if size_m.max() > 1.01 * MAX_SIDE_M:
        raise _wrong_size(size_m)


def _check_size(size_m: FloatArray) -> None:
    if not (size_m.min() >= _MIN_SIDE_M and size_m.max() <= MAX_SIDE_M):
        raise _wrong_size(size_m)


def _wrong_size(size_m: FloatArray) -> MapError:
    east_m, north_m = size_m.tolist()
    return MapError(
        f"the box is {east_m:.0f} x {north_m:.0f} m: a map is {_MIN_SIDE_M:g} to {MAX_SIDE_M:g} m "
        "wide, choose it with --box or --center"
    )
