"""What files say about a building: tags in their many spellings, and the height they stand for."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

LEVEL_M = 3.0
"""Height of a storey; OpenStreetMap's wiki (Simple 3D Buildings) says the same."""

_HEIGHTS = (
    "height", "building:height", "height:m", "measuredheight", "render:height", "hauteur",
    "hoehe",
)  # fmt: skip
_LEVELS = (
    "building:levels", "levels", "b:levels", "num:floors", "nb:floors", "number:of:floors",
    "numfloors", "maxfloors", "floors", "storeys", "stories",
)  # fmt: skip
_ROOF_LEVELS = ("roof:levels", "building:roof:levels")
_ROOF_HEIGHTS = ("roof:height", "building:roof:height")
_MIN_HEIGHTS = ("min:height", "building:min:height", "render:min:height")
_MIN_LEVELS = ("building:min:level", "min:level")
_BEGINS_ABOVE = (*_MIN_HEIGHTS, *_MIN_LEVELS, "base:height")
"""The last is where the ground lies in some files, so no roof is raised by it."""
_NAMES = ("name", "addr:housename")
_FOOT_M = 0.3048
_INCH_M = 0.0254
_NUMBER = r"(\d+(?:[.,]\d+)?)"
_THOUSAND_FEET = re.compile(r"(\d),(\d{3}) ?(?=f|')", re.IGNORECASE)
"""No building has a thousand metres; 1,250 ft are not 1.25."""
_BETWEEN = re.compile(r"[;\u2013-]")
_METRES = re.compile(rf"{_NUMBER}\s*(?:m|meters?|metres?)?\.?", re.IGNORECASE)
_FEET = re.compile(
    rf"{_NUMBER}\s*(?:ft|foot|feet|')\.?(?:\s*{_NUMBER}\s*(?:in|''|\"))?", re.IGNORECASE
)
_HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"\s*=>\s*"((?:[^"\\]|\\.)*)"')
_MOST_M = 10_000.0
"""No building is higher; a number beyond is a slip."""

Tags = Mapping[str, str | float]


class HeightSource(StrEnum):
    """Where a height comes from."""

    GIVEN = "given"
    LEVELS = "levels"
    ASSUMED = "assumed"


@dataclass(frozen=True, slots=True)
class BuildingHeight:
    """How high a roof is, and how that is known."""

    height_m: float
    source: HeightSource
    unreadable: bool
    """A height or a number of storeys was given that nobody can read."""


def read_tags(properties: Mapping[str, Any]) -> dict[str, str | float]:
    """Return the tags of a feature, flat, with keys in one spelling: ``building:min_level``.

    Takes properties as they are, with tags nested under ``tags`` (osmtogeojson), or packed into
    ``other_tags`` (GDAL). Keys become lower case with ``:`` for ``_``; the first spelling wins.
    """
    tags: dict[str, str | float] = {}
    nested = properties.get("tags")
    packed = properties.get("other_tags")
    sources: list[Mapping[str, Any]] = [properties]
    if isinstance(nested, Mapping):
        sources.insert(0, nested)
    if isinstance(packed, str):
        sources.append(dict(_HSTORE.findall(packed)))
    for source in sources:
        for key, value in source.items():
            if isinstance(value, bool):
                tags.setdefault(key.lower().replace("_", ":"), "yes" if value else "no")
            elif isinstance(value, str | int | float):
                plain = value.strip() if isinstance(value, str) else float(value)
                if plain != "":
                    tags.setdefault(key.lower().replace("_", ":"), plain)
    return tags


def is_building(tags: Tags) -> bool:
    """Return whether OpenStreetMap's tags call it a building or a part of one."""
    return any(str(tags.get(key, "no")).lower() != "no" for key in ("building", "building:part"))


def is_openstreetmap(tags: Tags, identity: str) -> bool:
    """Return whether a feature comes from OpenStreetMap, where buildings are tagged as such."""
    return identity.startswith(("node/", "way/", "relation/")) or any(
        key in tags for key in ("highway", "landuse", "natural", "leisure", "waterway", "railway")
    )


def is_part(tags: Tags) -> bool:
    """Return whether it is a part of a building, drawn besides the whole."""
    return str(tags.get("building:part", "no")).lower() != "no"


def is_underground(tags: Tags) -> bool:
    """Return whether it lies below the ground for all of its height."""
    # The second is Overture's.
    return (
        str(tags.get("location", "")).lower() == "underground"
        or str(tags.get("is:underground", "no")).lower() == "yes"
    )


def begins_above_ground(tags: Tags) -> bool:
    """Return whether there is air below it: an arch, a bridge, an upper part."""
    return any((_number(tags.get(key)) or 0.0) > 0.0 for key in _BEGINS_ABOVE)


def name_of(tags: Tags) -> str:
    """Return what people call it, or nothing."""
    return next((str(tags[key]) for key in _NAMES if key in tags), "")


def height_of(tags: Tags, default_m: float) -> BuildingHeight:
    """Return the height of a building's roof above the ground.

    A height as given, else ``LEVEL_M`` for each storey and each storey in the roof (or the
    height of the roof, if that is more), else the default. Of several spellings the first that can
    be read counts. A roof that were no higher than where the part begins is as far above that:
    its height was unknown, or told from there.
    """
    told = _told_height(tags, default_m)
    begins_m = max(_first(tags, _MIN_HEIGHTS) or 0.0, LEVEL_M * (_first(tags, _MIN_LEVELS) or 0.0))
    if told.height_m > begins_m:
        return told
    return replace(told, height_m=begins_m + told.height_m)


def _told_height(tags: Tags, default_m: float) -> BuildingHeight:
    height_m = _first(tags, _HEIGHTS)
    levels = _first(tags, _LEVELS)
    unreadable = any(key in tags and not _number(tags[key]) for key in _HEIGHTS + _LEVELS) and not (
        height_m or levels
    )
    if height_m:
        return BuildingHeight(height_m, HeightSource.GIVEN, unreadable)
    if levels:
        roof_m = max(
            LEVEL_M * (_first(tags, _ROOF_LEVELS) or 0.0), _first(tags, _ROOF_HEIGHTS) or 0.0
        )
        return BuildingHeight(LEVEL_M * levels + roof_m, HeightSource.LEVELS, unreadable)
    return BuildingHeight(default_m, HeightSource.ASSUMED, unreadable)


def parse_length_m(text: str) -> float | None:
    """Return a length in metres, ``None`` if there is none to be read.

    Understands ``12``, ``12.5 m``, ``12,5``, ``~12``, ``40 ft``, ``7'4"``, and takes the largest of
    several: ``12;15``, ``12-15 m``.
    """
    parts = _BETWEEN.split(text)
    lengths = [_single_length_m(part.strip().lstrip("~≈").strip()) for part in parts]
    known = [length_m for length_m in lengths if length_m is not None]
    return max(known) if known and len(known) == len(lengths) else None


def _single_length_m(text: str) -> float | None:
    if match := _METRES.fullmatch(text):
        return _decimal(match[1])
    if match := _FEET.fullmatch(_THOUSAND_FEET.sub(r"\1\2", text)):
        return _FOOT_M * _decimal(match[1]) + _INCH_M * _decimal(match[2] or "0")
    return None


def _decimal(text: str) -> float:
    return float(text.replace(",", "."))


def _number(value: str | float | None) -> float | None:
    """Return a positive number that a building can have, ``None`` for anything else."""
    number = parse_length_m(value) if isinstance(value, str) else value
    return number if number is not None and 0.0 < number <= _MOST_M else None


def _first(tags: Tags, keys: tuple[str, ...]) -> float | None:
    return next((number for key in keys if (number := _number(tags.get(key)))), None)
