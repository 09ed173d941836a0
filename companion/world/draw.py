"""A picture of a map from above: footprints coloured by height, paths and target on request.

Drawn on matplotlib's Agg canvas without pyplot: no display, no global figure. The axes are the
map's, metres east and north.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import shapely

from companion.arrays import FloatArray
from companion.errors import UsageError
from companion.world.maps import Map

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH_IN = 8.0
_DPI = 110
_GROUND = "#f4f1ea"
_INK = "#2b2b2b"
_SHADOW_PER_HEIGHT = np.array([0.06, -0.08])
"""The sun stands in the north-west, as on printed maps."""
_PATH_COLORS = ("#1565c0", "#ad1457", "#00838f", "#6a1b9a", "#2e7d32")
_SHADE = "#cdcac5"
_WALL_M = 0.6
"""How wide a wall is drawn, within what a pen can do."""
_NAMED_UP_TO = 12
"""Maps with more obstacles than this carry heights only: names would overlap."""
_LABELLED_UP_TO = 400
"""And with more than this, colours only."""


def draw_map(
    city: Map,
    path_png: str | Path,
    path_enu_m: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    target: npt.ArrayLike | None = None,
) -> None:
    """Draw a map as seen from above, 880 pixels wide, and write it as PNG.

    Args:
        city: What to draw.
        path_png: Where to write; the folder must exist.
        path_enu_m: A path flown, ``(N, 3)``, or several.
        target: A target, ``(3,)`` in map ENU metres.

    Raises:
        UsageError: If matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError(
            'drawing a map needs matplotlib: pip install "mavlink-companion[training]"'
        ) from error
    width_m, depth_m = float(city.size_m[0]), float(city.size_m[1])
    figure = Figure(
        figsize=(_WIDTH_IN, _height_in(width_m, depth_m)), dpi=_DPI, layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_facecolor(_GROUND)
    axes.set_aspect("equal")
    axes.set_xlim(0.0, width_m)
    axes.set_ylim(0.0, depth_m)
    axes.grid(color="white", linewidth=1.2, zorder=0)
    axes.tick_params(colors=_INK, labelsize=9)
    axes.set_xlabel("east of the map's corner (m)", fontsize=10)
    axes.set_ylabel("north of the map's corner (m)", fontsize=10)
    axes.set_title(_title(city), fontsize=12, loc="left", color=_INK)
    if len(city.obstacles) > 0:
        _draw_obstacles(axes, city)
    if city.launch_enu_m is not None:
        _mark(axes, city.launch_enu_m, "launch", marker="^", color="#2e7d32")
    for number, path_m in enumerate(_paths(path_enu_m)):
        _draw_path(axes, path_m, _PATH_COLORS[number % len(_PATH_COLORS)])
    if target is not None:
        _mark(axes, np.asarray(target, dtype=np.float64), "target", marker="*", color="#c62828")
    _draw_north(axes)
    try:
        figure.savefig(path_png, format="png")
    except OSError as error:
        raise UsageError(f"cannot write {path_png}: {error.strerror or error}") from error


def _height_in(width_m: float, depth_m: float) -> float:
    return float(np.clip(0.84 * _WIDTH_IN * depth_m / width_m + 0.9, 3.0, 12.0))


def _title(city: Map) -> str:
    title = f"{city.name}, {' x '.join(f'{side:g}' for side in city.size_m)} m"
    if city.origin is None:
        return title
    return f"{title}, corner at {city.origin.latitude_deg:.5f}, {city.origin.longitude_deg:.5f}"


def _draw_obstacles(axes: "Axes", city: Map) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    colors = LinearSegmentedColormap.from_list(
        "roofs", ["#dfe7ec", "#9db8c7", "#5d87a1", "#33566f", "#1b2f40"]
    )
    highest_m = float(city.heights_m.max())
    scale = Normalize(0.0, highest_m)
    points_per_m = 72.0 * 0.8 * _WIDTH_IN / float(city.size_m[0])
    # Low roofs first: where obstacles overlap, the higher one is on top.
    order = np.argsort(city.heights_m, kind="stable").tolist()
    shadows = [
        side
        for index in order
        for side in _shadow(city.footprints_m[index], float(city.heights_m[index]))
    ]
    axes.add_collection(PolyCollection(shadows, facecolor=_SHADE, linewidth=0, zorder=1))
    axes.add_collection(
        PolyCollection(
            [city.footprints_m[index] for index in order],
            facecolor=colors(scale(city.heights_m[order])),
            edgecolor=_INK,
            linewidth=float(np.clip(_WALL_M * points_per_m, 0.15, 0.9)),
            joinstyle="miter",
            zorder=2,
        )
    )
    for index in order if len(order) <= _LABELLED_UP_TO else ():
        height_m = float(city.heights_m[index])
        named = len(order) <= _NAMED_UP_TO
        _label_roof(
            axes,
            f"{city.obstacle_names[index]}\n{height_m:g} m" if named else f"{height_m:g}",
            city.footprints_m[index],
            points_per_m=points_per_m,
            color="white" if height_m > 0.4 * highest_m else _INK,
        )
    beside = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    bar = axes.figure.colorbar(ScalarMappable(scale, colors), cax=beside)
    bar.set_label("height of the roof (m)", fontsize=10)
    bar.ax.tick_params(labelsize=9)


def _shadow(footprint: FloatArray, height_m: float) -> FloatArray:
    """Return what every wall keeps from the sun, ``(V, 4, 2)``; the roofs are drawn over it."""
    away_m = _SHADOW_PER_HEIGHT * height_m
    after = np.roll(footprint, -1, axis=0)
    return np.stack((footprint, after, after + away_m, footprint + away_m), axis=1)


def _label_roof(
    axes: "Axes", text: str, footprint: FloatArray, *, points_per_m: float, color: str
) -> None:
    """Write where the footprint is widest, as large as fits; nothing where nothing fits."""
    polygon = shapely.Polygon(footprint)
    circle = shapely.maximum_inscribed_circle(polygon)
    center, radius_m = shapely.Point(circle.coords[0]), circle.length
    # The middle looks better where there is as much room.
    if polygon.covers(polygon.centroid):
        room_m = polygon.exterior.distance(polygon.centroid)
        if room_m > 0.9 * radius_m:
            center, radius_m = polygon.centroid, room_m
    room_pt = 2.0 * radius_m * points_per_m
    longest, lines = max(len(line) for line in text.split("\n")), 1 + text.count("\n")
    size_pt = min(10.0, room_pt / (0.62 * max(longest, 2)), room_pt / (1.3 * lines))
    if size_pt < 5.0:
        return
    axes.text(
        center.x,
        center.y,
        text,
        fontsize=size_pt,
        color=color,
        ha="center",
        va="center",
        linespacing=1.15,
        zorder=4,
    )


def _draw_path(axes: "Axes", path_m: FloatArray, color: str) -> None:
    """Draw a path with its height noted at a few places, as the paper does."""
    axes.plot(path_m[:, 0], path_m[:, 1], color=color, linewidth=2.0, zorder=5)
    axes.plot(path_m[:1, 0], path_m[:1, 1], "o", color=color, markersize=7, zorder=6)
    flown_m = np.cumsum(np.linalg.norm(np.diff(path_m, axis=0), axis=1))
    for fraction in (0.25, 0.5, 0.75) if len(flown_m) > 1 else ():
        place_m = path_m[1 + np.searchsorted(flown_m[:-1], fraction * flown_m[-1])]
        _note(axes, place_m, f"{place_m[2]:.0f} m", color)


def _mark(axes: "Axes", position_m: FloatArray, text: str, *, marker: str, color: str) -> None:
    size = 17 if marker == "*" else 11
    axes.plot(
        *position_m[:2],
        marker=marker,
        markersize=size,
        color=color,
        markeredgecolor="white",
        markeredgewidth=1.2,
        zorder=7,
    )
    _note(axes, position_m, f"{text} {position_m[2]:g} m" if position_m[2] else text, color)


def _note(axes: "Axes", position_m: FloatArray, text: str, color: str) -> None:
    halo = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
    axes.annotate(
        text,
        (float(position_m[0]), float(position_m[1])),
        xytext=(8, 6),
        textcoords="offset points",
        fontsize=8,
        color=color,
        bbox=halo,
        zorder=8,
    )


def _draw_north(axes: "Axes") -> None:
    from matplotlib.patheffects import withStroke

    # On a dark roof too.
    halo = [withStroke(linewidth=3.0, foreground="white")]
    axes.annotate(
        "N",
        xy=(0.965, 0.985),
        xytext=(0.965, 0.915),
        xycoords="axes fraction",
        ha="center",
        va="center",
        fontsize=10,
        color=_INK,
        arrowprops={
            "arrowstyle": "-|>",
            "color": _INK,
            "linewidth": 1.4,
            "path_effects": halo,
        },
        path_effects=halo,
        zorder=9,
    )


def _paths(path_enu_m: Any) -> list[FloatArray]:
    """Return one path or several as a list."""
    if path_enu_m is None:
        return []
    try:
        together = np.asarray(path_enu_m, dtype=np.float64)
    except ValueError:  # several of different lengths
        return [np.asarray(path_m, dtype=np.float64) for path_m in path_enu_m]
    return [together] if together.ndim == 2 else list(together)
