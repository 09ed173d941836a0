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
from sim.mock.personality import Personality
from sim.mock.px4.personality import PX4

if TYPE_CHECKING:  # shapely is loaded only where a map is flown
    from companion.world.maps import Map

_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_PROBE_M = 100.0
_ROOM_M = 5.0
"""From walls and from the edge of the map, for a take-off."""
_SPACING_M = 2.0
_MOST_PLACES = 300
"""Looked at along a side of the map."""
_PLACES_AT_ONCE = 100


@dataclass(frozen=True, slots=True)
class Place:
    """The place of power-up. Without a map, "map" coordinates are ENU metres from there.

    ``map_enu = launch_enu_m + matrix @ true_ned``. On a map with a place on earth the matrix
    holds what the autopilot's projection makes of WGS84 metres, so the referee judges where the
    vehicle truly is and not where a companion believes it to be.
    """

    home: GeoPoint
    map: Map | None
    launch_enu_m: FloatArray
    matrix: FloatArray
    projection: Projection
    """The autopilot's own, around ``home``."""

    def to_map(self, position_ned_m: Vector) -> FloatArray:
        """Return the map position of a true local one, shape ``(3,)``."""
        position_enu_m: FloatArray = self.launch_enu_m + self.matrix @ np.asarray(position_ned_m)
        return position_enu_m

    def to_geodetic(self, position_enu_m: FloatArray) -> GeoPoint:
        """Return where a point of the map lies on earth."""
        if self.map is not None and self.map.origin is not None:
            return enu_to_geodetic(self.map.origin, position_enu_m)
        east, north, up = (float(v) for v in position_enu_m - self.launch_enu_m)
        latitude, longitude = self.projection.to_geodetic(north, east)
        return GeoPoint(latitude, longitude, self.home.altitude_m + up)


def place_vehicle(map_: Map | None, home: GeoPoint | None, personality: Personality = PX4) -> Place:
    """Choose where the vehicle boots.

    Args:
        map_: The map, if any. One with ``launch_m`` says where local zero lies; on one with an
            ``origin`` the vehicle stands at ``home``.
        home: Wished place on earth; ``None`` for that of the personality's simulator, on a map
            with an ``origin`` for that of PX4 SITL on the ground, or where that is no free place
            on the map, for open ground near its middle.
        personality: The autopilot, whose projection ties local NED to the globe.

    Raises:
        MapError: If ``home`` lies outside the map or inside an obstacle.
    """
    project = personality.projection
    if map_ is None or map_.origin is None:
        wanted = home or personality.home
        launch = np.zeros(3)
        if map_ is not None and map_.launch_enu_m is not None:
            launch = np.asarray(map_.launch_enu_m)
        return Place(wanted, map_, launch, _NED_TO_ENU, project(wanted))
    wanted = home or PX4.home
    launch = geodetic_to_enu(map_.origin, wanted)
    if home is None:  # the altitude of PX4 SITL's home means nothing here: stand on the ground
        launch = np.array([launch[0], launch[1], 0.0])
        if not _is_free(map_, launch):
            launch = _open_ground(map_, launch)
        wanted = enu_to_geodetic(map_.origin, launch)
    standing = np.maximum(launch, [-np.inf, -np.inf, 0.0 if launch[2] > -1.0 else -np.inf])
    if not _is_free(map_, standing):
        raise MapError(
            f"home {wanted.latitude_deg:.6f},{wanted.longitude_deg:.6f},{wanted.altitude_m:.1f} is "
            f"not a free place on map {map_.name}: give one with --home LAT,LON,ALT"
        )
    projection = project(wanted)
    return Place(wanted, map_, launch, _tie(map_.origin, projection), projection)


def _is_free(map_: Map, position_enu_m: FloatArray) -> bool:
    return bool(map_.contains(position_enu_m)) and not bool(map_.obstacles.contains(position_enu_m))


def _open_ground(map_: Map, otherwise_m: FloatArray) -> FloatArray:
    """Return a place on the ground near the map's middle with room to take off, ``(3,)``."""
    size_m = map_.size_m[:2]
    spacing_m = max(_SPACING_M, float(size_m.max()) / _MOST_PLACES)
    east_m, north_m = (np.arange(_ROOM_M, side_m - _ROOM_M, spacing_m) for side_m in size_m)
    places_m = np.stack(np.meshgrid(east_m, north_m, [0.0]), axis=-1).reshape(-1, 3)
    order = np.argsort(np.square(places_m[:, :2] - 0.5 * size_m).sum(axis=1), kind="stable")
    for first in range(0, len(order), _PLACES_AT_ONCE):
        some_m = places_m[order[first : first + _PLACES_AT_ONCE]]
        roomy = map_.obstacles.signed_distance_m(some_m) >= _ROOM_M
        if roomy.any():
            return np.asarray(some_m[int(roomy.argmax())])
    return otherwise_m


def _tie(map_origin: GeoPoint, projection: Projection) -> FloatArray:
    """Return the Jacobian of map ENU by the autopilot's local NED around home."""
    columns = []
    for axis in np.eye(3) * _PROBE_M:
        ends = []
        for sign in (1.0, -1.0):
            north, east, down = (float(v) for v in sign * axis)
            latitude, longitude = projection.to_geodetic(north, east)
            point = GeoPoint(latitude, longitude, projection.reference.altitude_m - down)
            ends.append(geodetic_to_enu(map_origin, point))
        columns.append((ends[0] - ends[1]) / (2.0 * _PROBE_M))
    return np.stack(columns, axis=1)
