"""Paths from above over the obstacles, altitudes beside the dots: Figures 5 and 6."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from shapely import LineString
from shapely import Polygon as Outline

from companion.arrays import FloatArray
from companion.world.maps import load_map
from training.figure_style import BLACK, BLUE, GREEN, GREY, OBSTACLE, RED, YELLOW, new_figure, save
from training.flights import Flight
from training.report_data import Scene

_PANEL_IN = 5.2
_HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]
_OFFSET_PT = 13
_LABEL_M = 10.0
"""Half the width of an obstacle's label and of the altitudes beside a way."""
_ROOM_M = 5.5
"""Closer together, two altitudes cannot be read: the later one is left out."""


def draw_paths(scenes: Sequence[Scene], path: Path, heading: str) -> Path:
    """Draw one panel for each scene: Figure 6."""
    figure, panels = new_figure(
        len(scenes), width_in=_PANEL_IN * len(scenes), height_in=6.8, heading=heading
    )
    for letter, axes, scene in zip("abcdefgh", panels, scenes, strict=False):
        _draw_scene(axes, scene, f"({letter}) {scene.title}", moving=False)
    _legend(panels[0], moving=False)
    return save(figure, path)


def draw_chase(scene: Scene, path: Path, heading: str) -> Path:
    """Draw a chase from above and the distance to the target over the steps: Figure 5."""
    figure, panels = new_figure(2, width_in=2.1 * _PANEL_IN, height_in=6.6, heading=heading)
    _draw_scene(panels[0], scene, scene.title, moving=True)
    axes = panels[1]
    axes.set_title("Distance to the target")
    axes.set_xlabel("step")
    axes.set_ylabel("distance (m)")
    if scene.flight is not None:
        flight = scene.flight.flight()
        axes.plot(flight.distance_m, "o-", color=BLUE, markersize=4, label="vehicle to target")
        axes.axhline(5.0, color=GREEN, linestyle="--", label="arrived: 5 m")
        axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc="upper right")
    _legend(panels[0], moving=True)
    return save(figure, path)


def _draw_scene(axes: Axes, scene: Scene, title: str, *, moving: bool) -> None:
    """Draw a map from above with the heights of its obstacles, and the flight over it."""
    city = load_map(scene.map)
    flight = None if scene.flight is None else scene.flight.flight()
    east_m, north_m, _ = city.size_m
    axes.set_title(title)
    axes.set_aspect("equal")
    axes.set_xlim(-2.0, east_m + 2.0)
    axes.set_ylim(-2.0, north_m + 2.0)
    axes.set_xlabel(f"x, east (m)\n{scene.choice}")
    axes.set_ylabel("y, north (m)")
    way = None
    if flight is not None:
        way = LineString([*flight.target_enu_m[:1, :2], *flight.position_enu_m[::-1, :2]])
    for name, footprint_m, height_m in zip(
        city.obstacle_names, city.footprints_m, city.heights_m, strict=True
    ):
        axes.add_patch(Polygon(footprint_m, facecolor=OBSTACLE, edgecolor=GREY))
        axes.text(
            *_label_place_m(Outline(footprint_m), way),
            f"{name}\n{height_m:.0f} m",
            ha="center",
            va="center",
            fontsize=9,
            color="#404040",
            style="italic",
        )
    if flight is None:
        axes.text(0.5, 0.5, "no such case", transform=axes.transAxes, ha="center", fontsize=14)
        return
    _draw_flight(axes, flight, moving=moving)


def _label_place_m(outline: Outline, way: LineString | None) -> tuple[float, float]:
    """Return the point of an outline that is farthest from its edges and from the way."""
    west, south, east, north = outline.bounds
    corners_m = np.meshgrid(np.arange(west, east, 1.0), np.arange(south, north, 1.0))
    points = shapely.points(*(axis.ravel() for axis in corners_m))
    points = points[shapely.contains(outline, points)]
    if len(points) == 0:
        return outline.centroid.x, outline.centroid.y
    room_m = shapely.distance(points, outline.boundary)
    if way is not None:
        room_m += np.minimum(shapely.distance(points, way), _LABEL_M)
    best = points[int(np.argmax(room_m))]
    return best.x, best.y


def _draw_flight(axes: Axes, flight: Flight, *, moving: bool) -> None:
    position_m, target_m = flight.position_enu_m, flight.target_enu_m
    axes.plot(position_m[:, 0], position_m[:, 1], "--", color=BLUE, linewidth=1.6, zorder=3)
    axes.plot(
        position_m[1:, 0],
        position_m[1:, 1],
        "o",
        color=BLUE,
        markersize=5,
        zorder=4,
        label="vehicle",
    )
    axes.plot(
        *position_m[0, :2],
        "o",
        color=YELLOW,
        markeredgecolor=BLACK,
        markersize=10,
        zorder=5,
        label="start",
    )
    if moving:
        axes.plot(
            target_m[:, 0],
            target_m[:, 1],
            "--",
            color=BLACK,
            linewidth=1.4,
            zorder=3,
            label="way of the target",
        )
    axes.plot(
        *target_m[0, :2],
        "D",
        color=GREEN,
        markeredgecolor=BLACK,
        markersize=9,
        zorder=5,
        label="target at first" if moving else "target",
    )
    end = {"reached": ("*", GREEN), "collided": ("X", RED), "timed out": ("s", RED)}
    marker, colour = end[flight.outcome]
    axes.plot(
        *position_m[-1, :2],
        marker,
        color=colour,
        markeredgecolor=BLACK,
        markersize=13,
        zorder=6,
        label=flight.outcome,
        linestyle="none",
    )
    _altitudes(axes, position_m, target_m[:1])


def _altitudes(axes: Axes, position_m: FloatArray, target_m: FloatArray) -> None:
    """Write the altitudes beside the dots, on the left of the way, none over another."""
    points_m = np.concatenate((target_m, position_m[:1], position_m[1:]))
    ahead_m = np.gradient(position_m[:, :2], axis=0) if len(position_m) > 1 else np.ones((1, 2))
    away_m = position_m[-1:, :2] - position_m[-2:-1, :2] if len(position_m) > 1 else ahead_m
    directions = np.concatenate((-_left(away_m), _left(ahead_m)))
    written_m: list[FloatArray] = []
    for point_m, (east, north) in zip(points_m, directions, strict=True):
        place_m = point_m[:2] + 0.35 * _OFFSET_PT * np.array([east, north])
        if any(np.linalg.norm(place_m - other) < _ROOM_M for other in written_m):
            continue
        written_m.append(place_m)
        axes.annotate(
            f"{point_m[2]:.0f}",
            point_m[:2],
            xytext=(_OFFSET_PT * east, _OFFSET_PT * north),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=10,
            color=BLACK,
            path_effects=_HALO,
            zorder=7,
        )


def _left(ahead_m: FloatArray) -> FloatArray:
    """Return unit vectors to the left of horizontal ones, ``(N, 2)``."""
    length_m = np.maximum(np.linalg.norm(ahead_m, axis=1, keepdims=True), 1e-9)
    left: FloatArray = np.stack((-ahead_m[:, 1], ahead_m[:, 0]), axis=1) / length_m
    return left


def _legend(axes: Axes, *, moving: bool) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=len(handles),
            frameon=False,
            title="number beside a dot: altitude of the vehicle or the target in metres",
        )
