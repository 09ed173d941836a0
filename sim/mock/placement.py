"""Where the vehicle stands: true local NED, the map and the globe tied together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world.frames import GeoPoint, enu_to_geodetic, geodetic_to_enu
from sim.mock.dynamics import Vector
from sim.mock.geodesy import Projection

if TYPE_CHECKING:  # shapely is loaded only where a map is flown
    from companion.world.maps import Map

PX4_SITL_HOME = GeoPoint(47.397742, 8.545594, 489.4)
"""Where PX4 SITL boots."""

_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_PROBE_M = 100.0


@dataclass(frozen=True, slots=True)
class Place:
    """The place of power-up. Without a map, "map" coordinates are ENU metres from there.

    ``map_enu = launch_enu_m + matrix @ true_ned``. On a map with a place on earth the matrix
    holds what PX4's spherical projection makes of WGS84 metres, so the referee judges where the
    vehicle truly is and not where a companion believes it to be.
    """

    home: GeoPoint
    map: Map | None
    launch_enu_m: FloatArray
    matrix: FloatArray

    def to_map(self, position_ned_m: Vector) -> FloatArray:
        """Return the map position of a true local one, shape ``(3,)``."""
        position_enu_m: FloatArray = self.launch_enu_m + self.matrix @ np.asarray(position_ned_m)
        return position_enu_m

    def to_geodetic(self, position_enu_m: FloatArray) -> GeoPoint:
        """Return where a point of the map lies on earth."""
        if self.map is not None and self.map.origin is not None:
            return enu_to_geodetic(self.map.origin, position_enu_m)
        east, north, up = (float(v) for v in position_enu_m - self.launch_enu_m)
        latitude, longitude = Projection(self.home).to_geodetic(north, east)
        return GeoPoint(latitude, longitude, self.home.altitude_m + up)


def place_vehicle(map_: Map | None, home: GeoPoint | None) -> Place:
    """Choose where the vehicle boots.

    Args:
        map_: The map, if any. One with ``launch_m`` says where local zero lies; on one with an
            ``origin`` the vehicle stands at ``home``.
        home: Wished place on earth; ``None`` for that of PX4 SITL, on the ground of the map.

    Raises:
        MapError: If ``home`` lies outside the map or inside an obstacle.
    """
    wanted = home or PX4_SITL_HOME
    if map_ is None:
        return Place(wanted, None, np.zeros(3), _NED_TO_ENU)
    if map_.origin is None:
        launch = np.zeros(3) if map_.launch_enu_m is None else np.asarray(map_.launch_enu_m)
        return Place(wanted, map_, launch, _NED_TO_ENU)
    launch = geodetic_to_enu(map_.origin, wanted)
    if home is None:  # the altitude of PX4 SITL's home means nothing here: stand on the ground
        launch = np.array([launch[0], launch[1], 0.0])
        wanted = enu_to_geodetic(map_.origin, launch)
    standing = np.maximum(launch, [-np.inf, -np.inf, 0.0 if launch[2] > -1.0 else -np.inf])
    if not bool(map_.contains(standing)) or bool(map_.obstacles.contains(standing)):
        raise MapError(
            f"home {wanted.latitude_deg:.6f},{wanted.longitude_deg:.6f},{wanted.altitude_m:.1f} is "
            f"not a free place on map {map_.name}: give one with --home LAT,LON,ALT"
        )
    return Place(wanted, map_, launch, _tie(map_.origin, wanted))


def _tie(map_origin: GeoPoint, home: GeoPoint) -> FloatArray:
    """Return the Jacobian of map ENU by PX4's local NED around ``home``."""
    projection = Projection(home)
    columns = []
    for axis in np.eye(3) * _PROBE_M:
        ends = []
        for sign in (1.0, -1.0):
            north, east, down = (float(v) for v in sign * axis)
            latitude, longitude = projection.to_geodetic(north, east)
            point = GeoPoint(latitude, longitude, home.altitude_m - down)
            ends.append(geodetic_to_enu(map_origin, point))
        columns.append((ends[0] - ends[1]) / (2.0 * _PROBE_M))
    return np.stack(columns, axis=1)
