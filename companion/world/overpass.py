"""Elements from Overpass (``out geom``, or ways with their nodes) as GeoJSON features.

Closed ways become polygons, relations of type multipolygon polygons with courtyards, put together
from their members. A relation of type building only groups ways that carry tags of their own.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import shapely

from companion.errors import MapError

_Line = list[tuple[float, float]]


def read_elements(elements: Any, remark: str) -> list[tuple[str, Any]]:
    """Return a GeoJSON feature for every tagged way and relation, with what to call it.

    Args:
        elements: The ``elements`` of an Overpass answer.
        remark: Its ``remark``: what went wrong on the server.

    Raises:
        MapError: If they cannot be read or carry no geometry.
    """
    if not isinstance(elements, list):
        raise MapError("elements: expected an array")
    if "error" in remark.lower():
        raise MapError(f"Overpass did not finish: {' '.join(remark.split())}")
    for index, element in enumerate(elements):
        if not isinstance(element, dict) or not isinstance(element.get("id", 0), int):
            raise MapError(f"elements[{index}]: expected an object with a number as id")
    nodes = {
        element.get("id"): (element["lon"], element["lat"])
        for element in elements
        if element.get("type") == "node" and "lon" in element and "lat" in element
    }
    lines: dict[Any, _Line] = {
        element.get("id"): line
        for index, element in enumerate(elements)
        if element.get("type") == "way"
        and (line := _line(f"elements[{index}]", element, nodes)) is not None
    }
    features = []
    for index, element in enumerate(elements):
        kind, tags = element.get("type"), element.get("tags")
        if kind not in ("way", "relation") or not isinstance(tags, dict):
            continue
        where = f"elements[{index}]"
        if kind == "relation":
            if tags.get("type") == "building":
                continue
            polygons = _assemble(where, element, lines)
        else:
            line = lines.get(element.get("id"), [])
            polygons = [[line]] if len(line) > 3 and line[0] == line[-1] else []
        features.append((where, _feature(f"{kind}/{element.get('id')}", tags, polygons)))
    if features and not nodes and not any(_has_geometry(element) for element in elements):
        raise MapError("elements carry no coordinates: end the Overpass query with `out geom;`")
    return features


def _has_geometry(element: Mapping[str, Any]) -> bool:
    members = element.get("members")
    return "geometry" in element or (
        isinstance(members, list)
        and any(isinstance(member, dict) and "geometry" in member for member in members)
    )


def _feature(identity: str, tags: Mapping[str, Any], polygons: list[list[_Line]]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "id": identity,
        "properties": dict(tags),
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
    }


def _line(where: str, element: Mapping[str, Any], nodes: Mapping[Any, Any]) -> _Line | None:
    """Return the corners of a way or member, ``None`` where some are missing."""
    points = element.get("geometry")
    if isinstance(points, list):
        if any(point is None for point in points):
            return None
        if not all(isinstance(point, dict) for point in points):
            raise MapError(f"{where}.geometry: expected points with lon and lat")
        return [_place(where, point.get("lon"), point.get("lat")) for point in points]
    refs = element.get("nodes")
    if not isinstance(refs, list) or not all(isinstance(r, int) and r in nodes for r in refs):
        return None
    return [_place(where, *nodes[ref]) for ref in refs]


def _place(where: str, longitude_deg: Any, latitude_deg: Any) -> tuple[float, float]:
    for value, most in ((longitude_deg, 180.0), (latitude_deg, 90.0)):
        if not isinstance(value, int | float) or not abs(value) <= most:
            raise MapError(f"{where}: lon {longitude_deg} and lat {latitude_deg} are no place")
    return float(longitude_deg), float(latitude_deg)


def _assemble(
    where: str, relation: Mapping[str, Any], lines: Mapping[Any, _Line]
) -> list[list[_Line]]:
    """Return the polygons of a multipolygon; none if a member is missing."""
    members = relation.get("members")
    if not isinstance(members, list) or not all(isinstance(member, dict) for member in members):
        raise MapError(f"{where}.members: expected an array of objects")
    outer: list[_Line] = []
    inner: list[_Line] = []
    for member in members:
        if member.get("type") != "way":
            continue
        ref = member.get("ref")
        line = _line(where, member, {}) or (lines.get(ref) if isinstance(ref, int) else None)
        if line is None:
            return []
        (inner if member.get("role") == "inner" else outer).append(line)
    holes = _close(inner)
    polygons = []
    for shell in _close(outer):
        within = [hole for hole in holes if shell.covers(hole)]
        polygons.append([list(ring.exterior.coords) for ring in (shell, *within)])
    return polygons


def _close(lines: Sequence[_Line]) -> list[shapely.Polygon]:
    """Return the polygons that lines form together, end to end."""
    together = shapely.polygonize([shapely.LineString(line) for line in lines if len(line) > 1])
    return [shapely.Polygon(polygon.exterior) for polygon in together.geoms]
