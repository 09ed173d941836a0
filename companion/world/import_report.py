"""What an import did with a file, counted, and the same for people."""

from collections import Counter
from dataclasses import dataclass, field

from companion.world.building_tags import LEVEL_M, HeightSource
from companion.world.maps import Map

MIN_AREA_M2 = 1.0
"""Footprints, and courtyards, smaller than this are not worth a prism."""


@dataclass(slots=True)
class ImportReport:
    """What became of a file, counted in buildings unless another thing is named."""

    features: int = 0
    """In the file."""
    other_features: int = 0
    """Roads, trees and the like."""
    without_area: int = 0
    """Points, lines, nothing at all, relations with members missing."""
    underground: int = 0
    outside: int = 0
    """Of the box, wholly."""
    clipped: int = 0
    """At the edge of the box."""
    repaired: int = 0
    """Outlines that crossed or touched themselves."""
    invalid: int = 0
    """Outlines of which nothing was left after repair: dropped."""
    tiny: int = 0
    """Outlines, or parts of one in the box, below ``MIN_AREA_M2``: dropped."""
    courtyards: int = 0
    """Left open."""
    courtyards_filled: int = 0
    """Below ``MIN_AREA_M2``."""
    heights: Counter[HeightSource] = field(default_factory=Counter)
    """How the heights of the buildings on the map are known."""
    unreadable_heights: int = 0
    capped: int = 0
    """Higher than the map."""
    raised: int = 0
    """Begin above the ground, and were extruded from there all the same."""
    parts: int = 0
    """Of buildings, drawn besides the whole."""
    untagged: bool = False
    """Nothing in the file is tagged as a building: all areas were taken."""
    swapped: bool = False
    """Latitude and longitude look swapped."""

    @property
    def buildings(self) -> int:
        """Return how many are on the map."""
        return self.heights.total()


def describe_import(city: Map, report: ImportReport, default_height_m: float) -> str:
    """Return a summary for people, at most 80 columns wide, without a final newline."""
    count = report.buildings
    known = report.heights
    east_m, north_m, up_m = city.size_m
    origin = city.origin
    rows = [
        ("map", f"{_short(city.name, 30)}, {east_m:g} x {north_m:g} x {up_m:g} m east, north, up")
    ]
    if origin is not None:
        rows.append(
            (
                "place",
                f"{origin.latitude_deg:.6f}, {origin.longitude_deg:.6f} is its south-west corner",
            )
        )
    rows += [
        ("buildings", f"{count} as {len(city.obstacles)} obstacles, of {report.features} features"),
        (
            "heights",
            f"{known[HeightSource.GIVEN]} given, {known[HeightSource.LEVELS]} from storeys of "
            f"{LEVEL_M:g} m, {known[HeightSource.ASSUMED]} assumed {default_height_m:g} m",
        ),
        ("courtyards", f"{report.courtyards} open"),
        ("largest", _largest(city)),
        ("highest", _highest(city)),
    ]
    notes = [
        (report.parts, "building parts, kept besides the whole"),
        (report.raised, "begin above the ground: extruded from there, nothing flies below"),
        (report.capped, f"higher than the map: end at {up_m:g} m, the vehicle cannot pass above"),
        (
            report.unreadable_heights,
            f"heights that nobody can read: assumed {default_height_m:g} m",
        ),
        (report.clipped, "cut off at the edge of the box"),
        (report.repaired, "outlines repaired, they crossed or touched themselves"),
        (report.courtyards_filled, f"courtyards below {MIN_AREA_M2:g} m2 filled"),
        (report.tiny, f"outlines below {MIN_AREA_M2:g} m2 dropped"),
        (report.invalid, "outlines without area dropped"),
        (report.underground, "under the ground, dropped"),
        (report.without_area, "without an outline (points, lines, incomplete), dropped"),
        (report.outside, "outside the box"),
        (report.other_features, "features that are no buildings"),
    ]
    lines = [f"{title:<11}{text}" for title, text in rows]
    return "\n".join(lines + [f"{number:>9}  {text}" for number, text in notes if number])


def warnings_of(report: ImportReport) -> list[str]:
    """Return what should be looked at before anything flies, one line each."""
    warnings = []
    if report.swapped:
        warnings.append(
            "latitude and longitude look swapped: corners are right angles only the other way"
        )
    if report.untagged:
        warnings.append("nothing is tagged as a building: every area was taken for one")
    return warnings


def _largest(city: Map) -> str:
    extents_m = [footprint.max(axis=0) - footprint.min(axis=0) for footprint in city.footprints_m]
    index = max(range(len(extents_m)), key=lambda number: float(extents_m[number].prod()))
    east_m, north_m = extents_m[index]
    name = _short(city.obstacle_names[index], 30)
    return f"{name}, {east_m:.0f} x {north_m:.0f} m, {city.heights_m[index]:g} m high"


def _highest(city: Map) -> str:
    index = int(city.heights_m.argmax())
    return f"{_short(city.obstacle_names[index], 30)}, {city.heights_m[index]:g} m"


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 3]}..."
