"""Building footprints on earth -> a georeferenced map.

Every choice is on the safe side: what is not known is assumed high, an upper part is extruded
from the ground, whole and parts are both kept (geometry counts overlaps once), and what has to be
dropped is counted.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world import building_tags
from companion.world.building_file import Outline
from companion.world.building_tags import HeightSource
from companion.world.holes import cut_holes
from companion.world.import_report import ImportReport
from companion.world.map_box import MapBox
from companion.world.maps import Map, build_map
from companion.world.placement import Placed, place

_SPARE_M = 10.0
"""Of open ground around the buildings, where no box is given."""
_NAME_LENGTH = 40
_MOST_LOOKED_AT = 2000
_MIN_CORNERS = 40
_NO_CORNER = 0.7
"""Cosine above which an outline bends rather than turns a corner."""
_SKEWED, _SQUARE = 0.1, 0.03
"""Cosines at the corners of a city in the wrong and in the right plane."""


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What to make of a file."""

    name: str
    source: str
    """What to call the file in the map's description."""
    box: MapBox | None = None
    """By default all buildings, with some metres around them."""
    altitude_m: float = 0.0
    """Of the ground, above mean sea level, where no box says it."""
    ceiling_m: float = 100.0
    """Height of the map; higher roofs end there."""
    default_height_m: float = 15.0
    """Of buildings that say nothing of theirs."""
    tolerance_m: float = 0.2
    """By how much outlines may change to have fewer corners."""


def import_map(outlines: Sequence[Outline], options: ImportOptions) -> tuple[Map, ImportReport]:
    """Make a map of the buildings among a file's features.

    Raises:
        MapError: If there are no buildings, none in the box, or no map can be made of them.
    """
    report = ImportReport(features=len(outlines))
    buildings = _select(outlines, report)
    shells_deg = [rings[0] for building in buildings for rings in building.polygons_deg if rings]
    if not any(len(shell) for shell in shells_deg):
        raise MapError(_no_buildings(report))
    report.swapped = looks_swapped(shells_deg)
    box = options.box
    if box is None:
        box = MapBox.over(np.concatenate(shells_deg), _SPARE_M, options.altitude_m)
    names = _Names()
    obstacles: list[tuple[str, FloatArray, float]] = []
    for building in buildings:
        placed = place(building.polygons_deg, box, options.tolerance_m)
        _count(placed, report)
        if placed.polygons:
            height_m = _height_m(building, options, report)
            name = building_tags.name_of(building.tags) or building.identity
            obstacles += [
                (names.unused(name), np.round(footprint_m, 2), height_m)
                for polygon in placed.polygons
                for footprint_m in cut_holes(polygon)
            ]
    if not obstacles:
        raise MapError(_nothing_in(box, shells_deg))
    city = build_map(
        options.name,
        (box.east_m, box.north_m, options.ceiling_m),
        [footprint_m for _, footprint_m, _ in obstacles],
        [height_m for _, _, height_m in obstacles],
        obstacle_names=[name for name, _, _ in obstacles],
        description=_description(buildings, options, report),
        origin=box.origin,
    )
    return city, report


def looks_swapped(shells_deg: Sequence[FloatArray]) -> bool:
    """Return whether the corners of a city are right angles only if latitude comes first.

    Cannot tell where buildings stand along the axes, or where latitude and longitude are alike.

    Args:
        shells_deg: Outlines, ``(V, 2)`` each, longitude and latitude.
    """
    as_given: list[float] = []
    swapped: list[float] = []
    for shell_deg in shells_deg[:_MOST_LOOKED_AT]:
        if len(shell_deg) >= 3:
            shrunk_east, shrunk_north = np.cos(np.deg2rad(shell_deg.mean(axis=0)))[::-1]
            as_given += _corner_cosines(shell_deg * (shrunk_east, 1.0))
            swapped += _corner_cosines(shell_deg * (1.0, shrunk_north))
    if min(len(as_given), len(swapped)) < _MIN_CORNERS:
        return False
    return bool(np.median(as_given) > _SKEWED and np.median(swapped) < _SQUARE)


def _corner_cosines(shell: FloatArray) -> list[float]:
    """Return the cosine at every sharp corner of an outline: 0 at right angles."""
    edge = np.roll(shell, -1, axis=0) - shell
    length = np.hypot(edge[:, 0], edge[:, 1])
    along = edge[length > 0.0] / length[length > 0.0, None]
    cosines: FloatArray = np.abs((along * np.roll(along, 1, axis=0)).sum(axis=1))
    return [cosine for cosine in cosines.tolist() if cosine < _NO_CORNER]


class _Names:
    """Hands out every name once."""

    def __init__(self) -> None:
        self._last: Counter[str] = Counter()
        self._used: set[str] = set()

    def unused(self, wanted: str) -> str:
        plain = "".join(c if c.isprintable() else " " for c in wanted)
        base = " ".join(plain.split())[:_NAME_LENGTH].strip() or "building"
        name = base
        while name in self._used:
            self._last[base] += 1
            name = f"{base} {self._last[base] + 1}"
        self._used.add(name)
        return name


def _select(outlines: Sequence[Outline], report: ImportReport) -> list[Outline]:
    """Return the buildings that have an outline above the ground.

    If nothing is tagged as a building, all areas are: footprints from a survey. But of
    OpenStreetMap's features only those are buildings that say so.
    """
    report.untagged = not any(building_tags.is_building(outline.tags) for outline in outlines)
    buildings = []
    for outline in outlines:
        tags = outline.tags
        if not building_tags.is_building(tags) and (
            not report.untagged or building_tags.is_openstreetmap(tags, outline.identity)
        ):
            report.other_features += 1
        elif not outline.polygons_deg:
            report.without_area += 1
        elif building_tags.is_underground(tags):
            report.underground += 1
        else:
            buildings.append(outline)
    return buildings


def _count(placed: Placed, report: ImportReport) -> None:
    report.outside += not placed.inside and placed.invalid == 0
    report.repaired += placed.repaired and placed.inside
    report.clipped += placed.clipped and placed.inside
    report.invalid += placed.invalid
    report.tiny += placed.tiny
    report.courtyards += sum(len(polygon.interiors) for polygon in placed.polygons)
    report.courtyards_filled += placed.filled


def _height_m(building: Outline, options: ImportOptions, report: ImportReport) -> float:
    """Return the height of a building that is on the map, and count how it is known."""
    height = building_tags.height_of(building.tags, options.default_height_m)
    report.heights[height.source] += 1
    report.unreadable_heights += height.unreadable
    report.raised += building_tags.begins_above_ground(building.tags)
    report.parts += building_tags.is_part(building.tags)
    report.capped += height.height_m > options.ceiling_m
    # To the centimetre above: a wall is never lower than the file says.
    return min(float(np.ceil(np.round(height.height_m * 100.0, 6)) / 100.0), options.ceiling_m)


def _description(buildings: Sequence[Outline], options: ImportOptions, report: ImportReport) -> str:
    known = report.heights
    plain_source = "".join(c if c.isprintable() else "?" for c in options.source)
    text = (
        f"{report.buildings} buildings from {plain_source}; heights: "
        f"{known[HeightSource.GIVEN]} given, {known[HeightSource.LEVELS]} from storeys, "
        f"{known[HeightSource.ASSUMED]} assumed {options.default_height_m:g} m."
    )
    if any(building.identity.startswith(("way/", "relation/")) for building in buildings):
        text += " Map data from OpenStreetMap contributors, ODbL."
    return text


def _no_buildings(report: ImportReport) -> str:
    found = [
        f"{number} {what}"
        for number, what in (
            (report.other_features, "not tagged as buildings"),
            (report.without_area, "without an outline"),
            (report.underground, "under the ground"),
        )
        if number
    ]
    if not report.features:
        return "no buildings: the file has no features"
    return f"no buildings among {report.features} features: {', '.join(found) or 'none has area'}"


def _nothing_in(box: MapBox, shells_deg: Sequence[FloatArray]) -> str:
    """Say where the buildings are instead."""
    low_deg, high_deg = box.bounds_deg
    lows = np.array([shell.min(axis=0) for shell in shells_deg if len(shell)])
    highs = np.array([shell.max(axis=0) for shell in shells_deg if len(shell)])
    swapped = np.all((lows[:, ::-1] <= high_deg) & (highs[:, ::-1] >= low_deg), axis=1)
    west, south = lows.min(axis=0)
    east, north = highs.max(axis=0)
    text = (
        f"no buildings in the box: the file's lie between {south:.5f}, {west:.5f} and "
        f"{north:.5f}, {east:.5f} (latitude, longitude)"
    )
    if swapped.any():
        text += (
            f"; with the two swapped {int(swapped.sum())} would be in it: "
            "GeoJSON has longitude first"
        )
    return text
