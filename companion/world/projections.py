"""Coordinates of survey files, in metres on a plane, back to longitude and latitude.

The planes that GeoJSON in the wild names: Web Mercator and the zones of UTM. European ones
(ETRS89) count as WGS84: they drift apart by 2.5 cm a year, 0.9 m by now.
"""

import re
from collections.abc import Callable

import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError

ToDegrees = Callable[[FloatArray], FloatArray]
"""Takes positions ``(V, 2)`` as the file has them, returns longitude and latitude, ``(V, 2)``."""

_EARTH_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_DEGREES = ("4326", "4979", "4258", "crs84", "crs84h", "wgs84", "wgs 84")
_WEB_MERCATOR = ("3857", "900913", "102100", "102113", "3785")
_FARTHEST_M = 20_050_000.0
"""From the origin of any of these planes to a place on earth."""


def to_degrees(crs: str) -> ToDegrees:
    """Return what makes longitude and latitude of a file's coordinates.

    Args:
        crs: What the file calls them: ``EPSG:25832``, ``urn:ogc:def:crs:EPSG::3857`` or a link.

    Raises:
        MapError: If they are none of those that can be read.
    """
    code = re.split(r"[:/]", crs.strip().lower())[-1]
    if code in _DEGREES:
        return _as_they_are
    if code in _WEB_MERCATOR:
        return lambda place_m: _from_web_mercator(_metres(place_m, crs))
    if match := re.fullmatch(r"(326|327|258)(\d\d)", code):
        zone = int(match[2])
        if 1 <= zone <= 60:
            south = match[1] == "327"
            return lambda place_m: _from_utm(_metres(place_m, crs), zone, south=south)
    raise MapError(
        f"crs is {crs or 'not named'}: WGS84, Web Mercator (EPSG:3857) and UTM (EPSG:326xx, 327xx, "
        "258xx) can be read; make it one with `ogr2ogr -t_srs EPSG:4326 NEW.geojson OLD.geojson`"
    )


def _metres(place_m: FloatArray, crs: str) -> FloatArray:
    """Return coordinates as they are; those of a plane, in metres, are never so small."""
    if len(place_m) > 0 and bool(np.all(np.abs(place_m) <= (180.0, 90.0))):
        raise MapError(
            f"crs is {crs}, but coordinates such as {place_m[0, 0]:g}, {place_m[0, 1]:g} are "
            "degrees: correct what they are said to be"
        )
    return place_m


def _as_they_are(place_deg: FloatArray) -> FloatArray:
    return place_deg


def _from_web_mercator(place_m: FloatArray) -> FloatArray:
    """EPSG:3857 is a sphere's projection of the ellipsoid's latitudes."""
    east, north = np.clip(place_m, -_FARTHEST_M, _FARTHEST_M).T / _EARTH_M
    place_deg: FloatArray = np.rad2deg(np.column_stack((east, np.arctan(np.sinh(north)))))
    return place_deg


def _from_utm(place_m: FloatArray, zone: int, *, south: bool) -> FloatArray:
    """Transverse Mercator by Krueger's series (1912) to the third order: exact to a millimetre."""
    n = _FLATTENING / (2.0 - _FLATTENING)
    radius_m = 0.9996 * _EARTH_M / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    east_m, north_m = np.clip(place_m, -_FARTHEST_M, _FARTHEST_M).T
    xi = (north_m - (10_000_000.0 if south else 0.0)) / radius_m
    eta = (east_m - 500_000.0) / radius_m
    around = (
        n / 2.0 - 2.0 * n**2 / 3.0 + 37.0 * n**3 / 96.0,
        n**2 / 48.0 + n**3 / 15.0,
        17.0 * n**3 / 480.0,
    )
    sphere_xi, sphere_eta = xi.copy(), eta.copy()
    for order, share in enumerate(around, start=1):
        sphere_xi -= share * np.sin(2 * order * xi) * np.cosh(2 * order * eta)
        sphere_eta -= share * np.cos(2 * order * xi) * np.sinh(2 * order * eta)
    conformal = np.arcsin(np.sin(sphere_xi) / np.cosh(sphere_eta))
    latitude = conformal.copy()
    for order, share in enumerate(
        (2.0 * n - 2.0 * n**2 / 3.0 - 2.0 * n**3, 7.0 * n**2 / 3.0 - 8.0 * n**3 / 5.0,
         56.0 * n**3 / 15.0),
        start=1,
    ):  # fmt: skip
        latitude += share * np.sin(2 * order * conformal)
    meridian_deg = 6.0 * zone - 183.0
    longitude = np.arctan2(np.sinh(sphere_eta), np.cos(sphere_xi))
    return np.column_stack((meridian_deg + np.rad2deg(longitude), np.rad2deg(latitude)))
