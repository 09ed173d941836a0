"""The flight from above, and from the side, as inline SVG."""

import html
import itertools
from collections.abc import Callable, Sequence

import numpy as np
import shapely

from companion.arrays import FloatArray
from companion.review.svg import ink, nice_steps
from companion.session import colors
from companion.session.colors import Color
from companion.session.flight import City, Flight, Track

Place = Callable[[FloatArray], FloatArray]
"""Turns map positions into places on the drawing, ``(N, 2)``."""

_SIDE = 460.0
_RIM = 26.0
_MOST_PIECES = 1500


def plan(flight: Flight) -> str:
    """Return the map from above, north up, with the paths on it; empty without a path."""
    if flight.city is None or not len(flight.vehicle.time_s):
        return ""
    tracks = [("target", flight.target, colors.TARGET), ("", flight.vehicle, colors.MEASURED)]
    return plan_of(flight.city, tracks)


def plan_of(city: City, tracks: Sequence[tuple[str, Track, Color]]) -> str:
    """Return the map from above with some paths, each with its name at its end."""
    east_m, north_m, _ = city.size_m
    scale = (_SIDE - 2 * _RIM) / max(east_m, north_m)
    wide, high = east_m * scale + 2 * _RIM, north_m * scale + 2 * _RIM

    def place(points_m: FloatArray) -> FloatArray:
        corner = np.array([_RIM, high - _RIM])
        placed: FloatArray = corner + np.atleast_2d(points_m)[:, :2] * [1.0, -1.0] * scale
        return placed

    parts = [f'<svg class="plan" viewBox="0 0 {wide:.0f} {high:.0f}" role="img">']
    parts.append(
        f'<rect class="ground" x="{_RIM}" y="{_RIM}" width="{wide - 2 * _RIM:.1f}" '
        f'height="{high - 2 * _RIM:.1f}"/>'
    )
    for value in nice_steps(0.0, max(east_m, north_m), 5):
        parts += _grid(value, city, scale, wide, high)
    for ring, height_m in zip(city.footprints_m, city.heights_m, strict=False):
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in place(ring))
        inside = shapely.point_on_surface(shapely.Polygon(ring))
        x, y = place(shapely.get_coordinates(inside))[0]
        parts.append(
            f'<polygon class="obstacle" points="{corners}"/>'
            f'<text class="word dark" x="{x:.1f}" y="{y + 3:.1f}" text-anchor="middle">'
            f"{height_m:g} m</text>"
        )
    for name, track, color in tracks:
        parts += _track(track, place, color, 2.2 if name != "target" else 1.4)
    for name, track, color in tracks:
        if len(track.time_s):
            if name != "target":
                parts.append(_point(place(track.position_enu_m[0])[0], "start", colors.IDLE))
            below = name == "target"  # beside the name of the vehicle that has arrived
            at = place(track.position_enu_m[-1])[0]
            parts.append(_point(at, name or "end", color, below=below))
    parts.append(f'<text class="tick" x="{wide / 2:.0f}" y="12" text-anchor="middle">north</text>')
    return "".join([*parts, "</svg>"])


def _grid(value: float, city: City, scale: float, wide: float, high: float) -> list[str]:
    at, parts = value * scale, []
    if value <= city.size_m[0]:
        parts.append(
            f'<line class="grid" x1="{_RIM + at:.1f}" x2="{_RIM + at:.1f}" y1="{_RIM}" '
            f'y2="{high - _RIM:.1f}"/><text class="tick" x="{_RIM + at:.1f}" '
            f'y="{high - _RIM + 12:.1f}" text-anchor="middle">{value:g} m</text>'
        )
    if 0.0 < value <= city.size_m[1]:
        parts.append(
            f'<line class="grid" x1="{_RIM}" x2="{wide - _RIM:.1f}" '
            f'y1="{high - _RIM - at:.1f}" y2="{high - _RIM - at:.1f}"/>'
        )
    return parts


def _track(track: Track, place: Place, plain: Color, width: float) -> list[str]:
    """Return the path in pieces of one colour each."""
    count = len(track.time_s)
    if count < 2:
        return []
    step = max(1, count // _MOST_PIECES)
    kept = np.arange(0, count, step)
    points = place(track.position_enu_m[kept])
    shades = [track.color[index] for index in kept] if track.color else [plain] * len(kept)
    parts, begin = [], 0
    for color, group in itertools.groupby(range(len(kept)), lambda index: shades[index]):
        end = list(group)[-1]
        piece = points[max(0, begin - 1) : end + 1]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in piece)
        parts.append(f'<polyline points="{corners}" stroke="{ink(color)}" stroke-width="{width}"/>')
        begin = end + 1
    return parts


def _point(place: FloatArray, name: str, color: Color, *, below: bool = False) -> str:
    x, y = place
    text_y = y + 13.0 if below else y - 5.0
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{ink(color)}"/>'
        f'<text class="key" x="{x + 6:.1f}" y="{text_y:.1f}" fill="{ink(color)}">'
        f"{html.escape(name)}</text>"
    )
