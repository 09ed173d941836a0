"""The map view, for maps that lie somewhere on earth: outlines and paths by latitude and longitude.

The viewer fetches the picture below them from OpenStreetMap where there is a network; without one
the lines are drawn on an empty ground.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from companion.arrays import FloatArray
from companion.session import colors
from companion.session.records import MapRecord, SessionStart, Tick
from companion.session.writer import StreamWriter
from companion.world.frames import GeoPoint, enu_to_geodetic

_PERIOD_S = 0.5


class EarthView:
    """Logs where on earth everything is, two points a second."""

    def __init__(self, writer: StreamWriter, start: SessionStart) -> None:
        """Draw obstacles and geofence."""
        self._writer = writer
        self._to_earth = _to_earth(start.map)
        self._due_s = 0.0
        self._last_m: list[float] | None = None
        if self._to_earth is None:
            return
        east_m, north_m, _ = start.map.size_m
        fence_m = [[0.0, 0.0], [east_m, 0.0], [east_m, north_m], [0.0, north_m], [0.0, 0.0]]
        rings = [[*ring, ring[0]] for ring in start.map.footprints_m]
        writer.static(
            "earth/map",
            rr.GeoLineStrings(
                lat_lon=[self._place(ring) for ring in [fence_m, *rings]],
                colors=[colors.LIMIT],
                radii=rr.Radius.ui_points(1.5),
            ),
        )
        for who, color in (("vehicle", colors.MEASURED), ("target", colors.TARGET)):
            dot = rr.GeoPoints.from_fields(colors=[color], radii=rr.Radius.ui_points(6.0))
            writer.static(f"earth/{who}", dot)
        line = rr.GeoLineStrings.from_fields(
            colors=[colors.MEASURED], radii=rr.Radius.ui_points(2.5)
        )
        writer.static("earth/path", line)

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send one batch."""
        if self._to_earth is None:
            return
        for who in ("vehicle", "target"):
            kept = [tick for tick in ticks if _where(tick, who) is not None]
            kept = kept[:: max(1, len(kept) // 2)]
            if kept:
                places = self._place([_where(tick, who) for tick in kept])
                columns = rr.GeoPoints.columns(positions=places)
                self._writer.columns(f"earth/{who}", [tick.time_s for tick in kept], columns)
        self._send_path(ticks)

    def _send_path(self, ticks: Sequence[Tick]) -> None:
        times_s, pieces = [], []
        for tick in ticks:
            at_m = tick.position_enu_m
            if at_m is None or tick.time_s < self._due_s:
                continue
            self._due_s = tick.time_s + _PERIOD_S
            if self._last_m is not None:
                times_s.append(tick.time_s)
                pieces.append(self._place([self._last_m, at_m]))
            self._last_m = at_m
        if pieces:
            columns = rr.GeoLineStrings.columns(line_strings=pieces)
            self._writer.columns("earth/path", times_s, columns)

    def _place(self, points_m: Sequence[list[float] | None]) -> FloatArray:
        """Return latitude and longitude, degrees, shape ``(N, 2)``."""
        if self._to_earth is None:
            return np.empty((0, 2))
        flat_m = np.array([point[:2] for point in points_m if point is not None], dtype=np.float64)
        corner, per_metre = self._to_earth
        place: FloatArray = corner + flat_m @ per_metre
        return place


def _where(tick: Tick, who: str) -> list[float] | None:
    return tick.position_enu_m if who == "vehicle" else tick.target_enu_m


def _to_earth(city: MapRecord) -> tuple[FloatArray, FloatArray] | None:
    """Return the corner's latitude and longitude, and what a metre east and north adds."""
    if city.origin is None:
        return None
    origin = GeoPoint(*city.origin)
    east_m, north_m, _ = city.size_m

    def degrees(east: float, north: float) -> FloatArray:
        point = enu_to_geodetic(origin, np.array((east, north, 0.0)))
        return np.array((point.latitude_deg, point.longitude_deg))

    corner = degrees(0.0, 0.0)
    per_metre = np.stack(
        ((degrees(east_m, 0.0) - corner) / east_m, (degrees(0.0, north_m) - corner) / north_m)
    )
    return corner, per_metre
