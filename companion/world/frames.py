"""Map ENU, local NED and WGS84: the only conversions between them.

The *map frame* is ENU in metres (x east, y north, z up) with its origin at the map's south-west
ground corner. The *local frame* is the autopilot's NED around its own origin. Both are tangent
planes of the ellipsoid: their axes are straight and nothing bends with the earth.

Altitudes above mean sea level are used as if they were ellipsoidal. The geoid's height is the
same at both ends of a map and cancels; what is left is a scale of 1e-5, 2 mm in 200 m.
"""

from dataclasses import dataclass, field

import numpy as np
import pymap3d

from companion.arrays import FloatArray
from companion.errors import MapError

_SWAPPED = [1, 0, 2]


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A point on or above the WGS84 ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above mean sea level."""


def enu_to_ned(vector_enu: FloatArray) -> FloatArray:
    """Turn ENU components into NED components, shape ``(..., 3)``, any unit."""
    vector_ned = np.asarray(vector_enu, dtype=np.float64)[..., _SWAPPED]
    np.negative(vector_ned[..., 2], out=vector_ned[..., 2])
    return vector_ned


def ned_to_enu(vector_ned: FloatArray) -> FloatArray:
    """Turn NED components into ENU components, shape ``(..., 3)``, any unit."""
    return enu_to_ned(vector_ned)  # its own inverse


def geodetic_to_enu(origin: GeoPoint, point: GeoPoint) -> FloatArray:
    """Return ``point`` in the tangent plane at ``origin``: ENU metres, shape ``(3,)``."""
    return np.array(
        pymap3d.geodetic2enu(
            point.latitude_deg,
            point.longitude_deg,
            point.altitude_m,
            origin.latitude_deg,
            origin.longitude_deg,
            origin.altitude_m,
        ),
        dtype=np.float64,
    )


def ground_to_enu(
    origin: GeoPoint, latitude_deg: FloatArray, longitude_deg: FloatArray
) -> FloatArray:
    """Return places at the height of ``origin`` in its tangent plane: east, north, ``(N, 2)``.

    Args:
        origin: Where the plane touches.
        latitude_deg: Shape ``(N,)``.
        longitude_deg: Shape ``(N,)``.
    """
    east_m, north_m, _ = pymap3d.geodetic2enu(
        latitude_deg,
        longitude_deg,
        np.full_like(latitude_deg, origin.altitude_m),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_m,
    )
    return np.stack((east_m, north_m), axis=-1)


def enu_to_geodetic(origin: GeoPoint, position_enu_m: FloatArray) -> GeoPoint:
    """Return a point, shape ``(3,)``, of the tangent plane at ``origin`` on earth."""
    east_m, north_m, up_m = (float(value) for value in position_enu_m)
    latitude_deg, longitude_deg, altitude_m = pymap3d.enu2geodetic(
        east_m, north_m, up_m, origin.latitude_deg, origin.longitude_deg, origin.altitude_m
    )
    return GeoPoint(float(latitude_deg), float(longitude_deg), float(altitude_m))


@dataclass(frozen=True, slots=True, eq=False)
class LocalTie:
    """Ties the map frame to the autopilot's local NED: one linear map, one translation.

    Make one with ``from_origins`` or ``from_launch``, and a new one whenever the autopilot's
    origin moves.

    Autopilots lay their local frame on a sphere, so their metres are not quite metres: PX4's are
    0.3 % short from east to west at 47 degrees north. ``earth_radius_m`` undoes that, to a
    centimetre within half a kilometre of the local origin.
    """

    local_to_map: FloatArray  # (3, 3)
    """From local ENU axes to map axes: the identity but for the angle between the axes and the
    scale of the autopilot's sphere."""
    earth_to_map: FloatArray  # (3, 3)
    """The same for true metres around the local origin."""
    local_origin_enu_m: FloatArray  # (3,)
    """Where local NED is zero, on the map."""
    local_origin: GeoPoint | None
    """Where local NED is zero, on earth; ``None`` when nobody knows."""
    map_origin: GeoPoint | None
    """The map's south-west ground corner on earth; ``None`` when nobody knows."""
    map_to_local: FloatArray = field(init=False)  # (3, 3)
    """The inverse of ``local_to_map``, which every setpoint needs."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "map_to_local", np.linalg.inv(self.local_to_map))

    @classmethod
    def from_origins(
        cls, map_origin: GeoPoint, local_origin: GeoPoint, *, earth_radius_m: float | None = None
    ) -> "LocalTie":
        """Tie a georeferenced map to the local frame through ECEF.

        Args:
            map_origin: The map's south-west ground corner.
            local_origin: Where local NED is zero.
            earth_radius_m: Radius of the autopilot's sphere; ``None`` where its metres are true.
        """
        rotation = _rotation(local_origin, map_origin)
        return cls(
            local_to_map=rotation * _true_metres(local_origin, earth_radius_m),
            earth_to_map=rotation,
            local_origin_enu_m=geodetic_to_enu(map_origin, local_origin),
            local_origin=local_origin,
            map_origin=map_origin,
        )

    @classmethod
    def from_launch(
        cls,
        launch_enu_m: FloatArray,
        local_origin: GeoPoint | None,
        *,
        earth_radius_m: float | None = None,
    ) -> "LocalTie":
        """Lay a map without a place on earth around the local origin, axes parallel.

        The map's metres are then the autopilot's own.

        Args:
            launch_enu_m: The map's point at which local NED is zero, shape ``(3,)``.
            local_origin: Where that is on earth, if known; only the geodetic conversions need it.
            earth_radius_m: Radius of the autopilot's sphere; ``None`` where its metres are true.
        """
        launch_m = np.array(launch_enu_m, dtype=np.float64)
        earth_to_map, map_origin = np.eye(3), None
        if local_origin is not None:
            true_metres = _true_metres(local_origin, earth_radius_m)
            earth_to_map = np.diag(1.0 / true_metres)
            corner_enu_m: FloatArray = -launch_m * true_metres
            map_origin = enu_to_geodetic(local_origin, corner_enu_m)
        return cls(
            local_to_map=np.eye(3),
            earth_to_map=earth_to_map,
            local_origin_enu_m=launch_m,
            local_origin=local_origin,
            map_origin=map_origin,
        )

    def position_to_map(self, position_ned_m: FloatArray) -> FloatArray:
        """Return local NED positions in map ENU, shape ``(..., 3)``."""
        return self.velocity_to_map(position_ned_m) + self.local_origin_enu_m

    def position_to_local(self, position_enu_m: FloatArray) -> FloatArray:
        """Return map ENU positions in local NED, shape ``(..., 3)``."""
        return self.velocity_to_local(np.asarray(position_enu_m) - self.local_origin_enu_m)

    def velocity_to_map(self, velocity_ned_mps: FloatArray) -> FloatArray:
        """Return local NED velocities in map ENU, shape ``(..., 3)``."""
        velocity_enu_mps: FloatArray = ned_to_enu(velocity_ned_mps) @ self.local_to_map.T
        return velocity_enu_mps

    def velocity_to_local(self, velocity_enu_mps: FloatArray) -> FloatArray:
        """Return map ENU velocities in local NED, shape ``(..., 3)``."""
        return enu_to_ned(np.asarray(velocity_enu_mps, dtype=np.float64) @ self.map_to_local.T)

    def geodetic_to_map(self, point: GeoPoint) -> FloatArray:
        """Return a point on earth in map ENU, shape ``(3,)``.

        Raises:
            MapError: If nobody knows where the local origin is on earth.
        """
        local_enu_m = geodetic_to_enu(self._known_origin(), point)
        position_enu_m: FloatArray = self.earth_to_map @ local_enu_m + self.local_origin_enu_m
        return position_enu_m

    def map_to_geodetic(self, position_enu_m: FloatArray) -> GeoPoint:
        """Return a map ENU position, shape ``(3,)``, as a point on earth.

        Raises:
            MapError: If nobody knows where the local origin is on earth.
        """
        offset_m = np.asarray(position_enu_m) - self.local_origin_enu_m
        local_enu_m: FloatArray = np.linalg.solve(self.earth_to_map, offset_m).astype(np.float64)
        return enu_to_geodetic(self._known_origin(), local_enu_m)

    def _known_origin(self) -> GeoPoint:
        if self.local_origin is None:
            raise MapError(
                "the map is not tied to the earth: it has no origin and the autopilot reports none"
            )
        return self.local_origin


def _rotation(from_point: GeoPoint, to_point: GeoPoint) -> FloatArray:
    """Return the rotation from the ENU axes at one point to those at another, ``(3, 3)``."""
    ecef = pymap3d.enu2uvw(*np.eye(3), from_point.latitude_deg, from_point.longitude_deg)
    enu = pymap3d.ecef2enuv(*ecef, to_point.latitude_deg, to_point.longitude_deg)
    return np.array(enu, dtype=np.float64)


def _true_metres(place: GeoPoint, earth_radius_m: float | None) -> FloatArray:
    """Return how many true metres one metre of a sphere is, east, north and up, ``(3,)``.

    The ellipsoid's radii of curvature at ``place`` over the radius of the sphere.
    """
    if earth_radius_m is None:
        return np.ones(3)
    ellipsoid = pymap3d.Ellipsoid.from_name("wgs84")
    sin_latitude = np.sin(np.radians(place.latitude_deg))
    flatness = 1.0 - (ellipsoid.eccentricity * sin_latitude) ** 2
    east_m = ellipsoid.semimajor_axis / np.sqrt(flatness) + place.altitude_m
    meridian = ellipsoid.semimajor_axis * (1.0 - ellipsoid.eccentricity**2)
    north_m = meridian / flatness**1.5 + place.altitude_m
    return np.array([east_m / earth_radius_m, north_m / earth_radius_m, 1.0])
