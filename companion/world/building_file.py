"""Files of building footprints as they come: GeoJSON, or JSON from Overpass.

Both become the same flat list of outlines with tags; which of them are buildings, and where they
lie, is for ``map_import``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.world.building_tags import Tags, read_tags
from companion.world.overpass import read_elements
from companion.world.projections import ToDegrees, to_degrees

MAX_FILE_BYTES = 2**28
"""256 MiB are about half a million buildings: a file of a country, to be cut first."""
_SEQUENCE = re.compile(rb"\s*(\x1e|\{[^\n]*\}\s*\n\s*\{)")
"""A feature a line, as GDAL's GeoJSONSeq and RFC 8142 have it."""
_AREAS = ("Polygon", "MultiPolygon")
_OTHERS = ("Point", "MultiPoint", "LineString", "MultiLineString")
_SCRIPT = re.compile(rb"\s*(?:var|let|const)\s+\w+\s*=\s*(?P<data>\{.*\})\s*;?\s*", re.DOTALL)
"""GeoJSON as a line of JavaScript, as web maps are exported."""


@dataclass(frozen=True, slots=True)
class Outline:
    """One feature of a file."""

    where: str
    """What to call it in errors: ``features[12]``."""
    identity: str
    """What the file calls it, such as ``way/123``; may be empty."""
    tags: Tags
    polygons_deg: tuple[tuple[FloatArray, ...], ...]
    """For each polygon its rings, the outer one first, ``(V, 2)`` each, longitude and latitude,
    not closed. Empty for points, lines and features without geometry."""


def read_building_file(path: Path, crs: str = "") -> list[Outline]:
    """Read all features of a GeoJSON or Overpass file.

    Args:
        path: The file.
        crs: Its coordinates, if it does not name them; by default longitude and latitude.

    Raises:
        MapError: If it is neither, or a coordinate is no place on earth. The message names the
            feature, not the file.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise MapError((error.strerror or str(error)).lower()) from error
    if len(data) > MAX_FILE_BYTES:
        raise MapError(f"larger than {MAX_FILE_BYTES // 2**20} MiB: cut out what you need first")
    return read_outlines(data, crs)


def read_outlines(data: bytes, crs: str = "") -> list[Outline]:
    """Return all features of a file's bytes; raises ``MapError`` as ``read_building_file``."""
    top = _decode(data)
    if not isinstance(top, dict):
        raise MapError(f"not GeoJSON: expected an object, got {_kind(top)}")
    if "elements" in top and "type" not in top:
        features = read_elements(top["elements"], str(top.get("remark", "")))
        crs = ""
    else:
        crs = _named_crs(top) or crs
        features = _features(top)
    degrees = to_degrees(crs or "EPSG:4326")
    return [_outline(where, feature, degrees) for where, feature in features]


def _decode(data: bytes) -> Any:
    if not data.strip():
        raise MapError("not GeoJSON: the file is empty")
    try:
        data = _utf8(data)
        if _SEQUENCE.match(data):
            features = msgspec.json.Decoder().decode_lines(data.replace(b"\x1e", b""))
            return {"type": "FeatureCollection", "features": features}
        script = _SCRIPT.fullmatch(data)
        return msgspec.json.decode(data if script is None else script["data"])
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        if data.lstrip().startswith(b"<"):
            raise MapError(
                "XML, not GeoJSON: `ogr2ogr NEW.geojson OLD` makes one of most"
            ) from error
        raise MapError(f"not JSON: {str(error).removeprefix('JSON is malformed: ')}") from error
    except RecursionError as error:
        raise MapError("not JSON: nested too deeply") from error


def _utf8(data: bytes) -> bytes:
    """Return a file's text as UTF-8, from what editors and shells on Windows write as well."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16").encode()
    data = data.removeprefix(b"\xef\xbb\xbf")
    try:
        data.decode()
    except UnicodeDecodeError:
        # Only names have letters beyond ASCII: at worst one of them is spelt wrongly.
        return data.decode("cp1252", errors="replace").encode()
    return data


def _named_crs(top: Mapping[str, Any]) -> str:
    """Return what a file says its coordinates are (GeoJSON of 2008 could), or nothing."""
    crs = top.get("crs")
    if crs is None:
        return ""
    properties = crs.get("properties") if isinstance(crs, dict) else None
    said = properties if isinstance(properties, dict) else {"name": crs}
    name = next((said[key] for key in ("name", "code", "href") if key in said), None)
    # Of a link such as .../epsg/4326/ the last word tells.
    plain = str(name).strip().rstrip("/") if isinstance(name, str | int) else ""
    return plain or "not named"


def _features(top: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return every feature with what to call it."""
    kind = top.get("type")
    if kind == "FeatureCollection":
        features = top.get("features")
        if not isinstance(features, list):
            raise MapError(f"features: expected an array, got {_kind(features)}")
        return [(f"features[{index}]", feature) for index, feature in enumerate(features)]
    if kind == "Feature":
        return [("feature", top)]
    if kind in (*_AREAS, *_OTHERS, "GeometryCollection"):
        return [("geometry", {"type": "Feature", "geometry": top, "properties": None})]
    raise MapError(
        f"not GeoJSON: type is {kind!r}, not FeatureCollection"
        if kind is not None
        else "not GeoJSON: it has neither a type nor Overpass elements"
    )


def _outline(where: str, feature: Any, degrees: ToDegrees) -> Outline:
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        found = feature.get("type") if isinstance(feature, dict) else _kind(feature)
        raise MapError(f"{where}: expected a Feature, got {found}")
    properties = feature.get("properties") or {}
    if not isinstance(properties, dict):
        raise MapError(f"{where}.properties: expected an object, got {_kind(properties)}")
    identity = feature.get("id", properties.get("@id", properties.get("id", "")))
    if isinstance(identity, int) and properties.get("type") in ("way", "relation"):
        identity = f"{properties['type']}/{identity}"
    geometry = feature.get("geometry")
    return Outline(
        where=where,
        identity=str(identity) if isinstance(identity, str | int) else "",
        tags=read_tags(properties),
        polygons_deg=() if geometry is None else _polygons(f"{where}.geometry", geometry, degrees),
    )


def _polygons(where: str, geometry: Any, degrees: ToDegrees) -> tuple[tuple[FloatArray, ...], ...]:
    """Return the polygons of any geometry."""
    kind = geometry.get("type") if isinstance(geometry, dict) else _kind(geometry)
    if kind == "GeometryCollection":
        parts = geometry.get("geometries")
        return tuple(
            polygon
            for index, part in enumerate(_array(f"{where}.geometries", parts))
            for polygon in _polygons(f"{where}.geometries[{index}]", part, degrees)
        )
    if kind in _OTHERS:
        return ()
    if kind not in _AREAS:
        raise MapError(f"{where}: {kind!r} is no geometry of GeoJSON")
    where = f"{where}.coordinates"
    coordinates = geometry.get("coordinates")
    if kind == "Polygon":
        return (_rings(where, coordinates, degrees),)
    return tuple(
        _rings(f"{where}[{index}]", rings, degrees)
        for index, rings in enumerate(_array(where, coordinates))
    )


def _rings(where: str, rings: Any, degrees: ToDegrees) -> tuple[FloatArray, ...]:
    return tuple(
        _ring(f"{where}[{index}]", ring, degrees) for index, ring in enumerate(_array(where, rings))
    )


def _ring(where: str, ring: Any, degrees: ToDegrees) -> FloatArray:
    """Return a ring as longitudes and latitudes, not closed."""
    try:
        positions = msgspec.convert(ring, list[list[float]])
    except msgspec.ValidationError as error:
        problem, _, place = str(error).partition(" - at `$")
        problem = problem[:1].lower() + problem[1:]
        raise MapError(f"{where}{place.rstrip('`')}: {problem}") from error
    short = next((index for index, place in enumerate(positions) if len(place) < 2), None)
    if short is not None:
        raise MapError(f"{where}[{short}] needs a longitude and a latitude")
    ring_deg = degrees(
        np.array([place[:2] for place in positions], dtype=np.float64).reshape(-1, 2)
    )
    # Written so that nan fails too.
    strange = ~np.all(np.abs(ring_deg) <= (180.0, 90.0), axis=1)
    if strange.any():
        index = int(strange.argmax())
        raise MapError(f"{where}[{index}] {_explain(*ring_deg[index].tolist())}")
    closed = len(ring_deg) > 1 and np.array_equal(ring_deg[0], ring_deg[-1])
    return ring_deg[:-1] if closed else ring_deg


def _explain(longitude_deg: float, latitude_deg: float) -> str:
    if abs(latitude_deg) <= 180.0 and abs(longitude_deg) <= 90.0:
        return (
            f"has latitude {latitude_deg:g}: latitude and longitude seem to be swapped, "
            "GeoJSON has longitude first"
        )
    return (
        f"({longitude_deg:g}, {latitude_deg:g}) is no longitude and latitude: "
        "say which plane it is on with --crs EPSG:..., or convert the file to WGS84 (EPSG:4326)"
    )


def _array(where: str, value: Any) -> Sequence[Any]:
    if not isinstance(value, list):
        raise MapError(f"{where}: expected an array, got {_kind(value)}")
    return value


def _kind(value: Any) -> str:
    kinds = {dict: "object", list: "array", str: "text", bool: "truth value", type(None): "null"}
    return kinds.get(type(value), "number")
