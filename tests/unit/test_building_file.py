"""Files of footprints: GeoJSON and Overpass, as they come, wrong and damaged."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import MapError
from companion.world.building_file import read_outlines
from companion.world.frames import GeoPoint, enu_to_geodetic
from companion.world.map_box import MapBox
from companion.world.map_import import ImportOptions, import_map

CORNER = GeoPoint(47.37, 8.54, 0.0)


def degrees(points_m, corner=CORNER):
    """Return ENU points as GeoJSON positions."""
    places = [enu_to_geodetic(corner, np.array([x, y, 0.0])) for x, y in points_m]
    return [[place.longitude_deg, place.latitude_deg] for place in places]


def ring(points_m, corner=CORNER):
    places = degrees(points_m, corner)
    return [*places, places[0]]


def square(x, y, side=10.0):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


def feature(*rings_m, corner=CORNER, **properties):
    geometry = {"type": "Polygon", "coordinates": [ring(points, corner) for points in rings_m]}
    properties.setdefault("building", "yes")
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def collection(*features):
    return {"type": "FeatureCollection", "features": list(features)}


def run(top, **options):
    outlines = read_outlines(json.dumps(top).encode())
    return import_map(outlines, ImportOptions(**{"name": "town", "source": "town.json"} | options))


BOX = MapBox(CORNER, 100.0, 80.0)


# -- refused ------------------------------------------------------------------------------------

GOOD = feature(square(10, 10))


def spoilt(coordinates):
    geometry = {"type": "Polygon", "coordinates": coordinates}
    return collection(GOOD, {"type": "Feature", "properties": {}, "geometry": geometry})


WRONG = {
    "empty": (b"", "the file is empty"),
    "no JSON": (b"{", "not JSON: Input data was truncated"),
    "not text": (b"\xff\xfe{\xd8", "not JSON"),
    "too deep": (b"[" * 100_000, "not JSON: nested too deeply"),
    "an array": ([], "not GeoJSON: expected an object, got array"),
    "other JSON": ({"a": 1}, "neither a type nor Overpass elements"),
    "TopoJSON": ({"type": "Topology"}, "type is 'Topology', not FeatureCollection"),
    "no features": ({"type": "FeatureCollection"}, "features: expected an array, got null"),
    "nothing": (collection(), "no buildings: the file has no features"),
    "no feature": (collection(GOOD, 3), r"features\[1\]: expected a Feature, got number"),
    "only a road": (
        collection(feature(square(1, 1), building="no", highway="road")),
        "no buildings among 1 features: 1 not tagged as buildings",
    ),
    "Swiss grid": (
        spoilt([[[2683141, 1247945], [2683151, 1247945], [2683151, 1247955]]]),
        r"features\[1\].geometry.coordinates\[0\]\[0\] .*convert the file to WGS84",
    ),
    "named grid": (
        collection(GOOD) | {"crs": {"properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}},
        "crs is urn:ogc:def:crs:EPSG::2056: WGS84, .*ogr2ogr -t_srs EPSG:4326",
    ),
    "degrees on a plane": (
        collection(GOOD) | {"crs": {"properties": {"name": "EPSG:32632"}}},
        "crs is EPSG:32632, but coordinates such as .* are degrees",
    ),
    "nameless crs": (collection(GOOD) | {"crs": {"properties": [1]}}, "crs is not named"),
    "XML": (b"\n<?xml version='1.0'?><osm/>", "XML, not GeoJSON: `ogr2ogr"),
    "latitude first": (
        spoilt([[[35.6, 139.7], [35.7, 139.7], [35.7, 139.8]]]),
        r"features\[1\].* latitude 139.7: latitude and longitude seem to be swapped",
    ),
    "text": (
        spoilt([[[8.5, 47.3], [8.5, "47.4"], [8.6, 47.4]]]),
        r"features\[1\].geometry.coordinates\[0\]\[1\]\[1\]: expected `float`, got `str`",
    ),
    "one number": (spoilt([[[8.5], [8.5, 47.4], [8.6, 47.4]]]), r"\[0\]\[0\] needs a longitude"),
    "no rings": (spoilt(None), r"features\[1\].geometry.coordinates: expected an array, got null"),
    "circle": (
        collection({"type": "Feature", "geometry": {"type": "Circle"}, "properties": {}}),
        r"features\[0\].geometry: 'Circle' is no geometry",
    ),
    "properties": (
        collection({"type": "Feature", "geometry": None, "properties": [1]}),
        r"features\[0\].properties: expected an object, got array",
    ),
}


@pytest.mark.parametrize(("content", "message"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_read_says_where(content, message):
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    with pytest.raises(MapError, match=message):
        import_map(read_outlines(data), ImportOptions("town", "town.json"))


def on_mercator(outline_m):
    """Return a ring in Web Mercator, written as its definition has it."""
    longitude, latitude = np.deg2rad(np.array(ring(outline_m))).T
    north = np.log(np.tan(np.pi / 4 + latitude / 2))
    return (6_378_137.0 * np.column_stack((longitude, north))).tolist()


@pytest.mark.parametrize("named", [True, False], ids=["named in the file", "said by hand"])
def test_footprints_on_a_plane_in_metres(named):
    outline = square(10, 10)
    geometry = {"type": "Polygon", "coordinates": [on_mercator(outline)]}
    top = collection({"type": "Feature", "properties": {"building": True}, "geometry": geometry})
    if named:
        top["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}
    outlines = read_outlines(json.dumps(top).encode(), "" if named else "EPSG:3857")
    city, _ = import_map(outlines, ImportOptions(name="town", source="town.json", box=BOX))
    np.testing.assert_allclose(sorted(city.footprints_m[0].tolist()), sorted(outline), atol=0.011)


def test_a_file_on_a_plane_that_does_not_say_so_is_refused_with_what_to_do():
    geometry = {"type": "Polygon", "coordinates": [on_mercator(square(10, 10))]}
    with pytest.raises(MapError, match="say which plane it is on with --crs EPSG"):
        run(collection({"type": "Feature", "properties": {}, "geometry": geometry}))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_files_from_windows(encoding):
    text = json.dumps(collection(feature(square(10, 10), name="B\u00e4che")), ensure_ascii=False)
    (outline,) = read_outlines(text.encode(encoding))
    assert outline.tags["name"] == "B\u00e4che"


@pytest.mark.parametrize("script", ["var json_house_1 = {};", "const a={}", " let x = \n{}\n;\n"])
def test_geojson_as_a_script(script):
    top = json.dumps(collection(feature(square(10, 10))))
    assert len(read_outlines(script.replace("{}", top).encode())) == 1


def test_parts_of_one_building_that_touch_are_one():
    geometry = {
        "type": "MultiPolygon",
        "coordinates": [
            [ring(square(10, 10))], [ring(square(20, 10))], [ring(square(15, 5))],
            [ring(square(60, 60))],
        ],
    }  # fmt: skip
    city, report = run(
        collection({"type": "Feature", "properties": {"building": "yes"}, "geometry": geometry}),
        box=BOX,
    )
    assert (report.buildings, len(city.obstacles)) == (1, 2)
    inside_m = np.array([(15, 15, 1), (25, 15, 1), (20, 7, 1), (19.99, 18, 1), (65, 65, 1)])
    assert city.obstacles.contains(inside_m).all()
    assert city.is_free(np.array([12.0, 7.0, 1.0]), 1.9)


@pytest.mark.parametrize(
    "crs",
    [
        {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
        {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4326"}},
        {"type": "EPSG", "properties": {"code": 4326}},
        {"type": "link", "properties": {"href": "http://spatialreference.org/ref/epsg/4326/"}},
        "EPSG:4326",
        None,
    ],
)
def test_crs_that_are_wgs84(crs):
    assert run(collection(GOOD) | {"crs": crs}, box=BOX)[1].buildings == 1


# -- Overpass -----------------------------------------------------------------------------------


def way(number, points_m, *, closed=True, **tags):
    places = [*points_m, points_m[0]] if closed else points_m
    geometry = [{"lon": lon, "lat": lat} for lon, lat in degrees(places)]
    return {"type": "way", "id": number, "geometry": geometry, "tags": tags}


def member(number, points_m, role, *, closed=True):
    return {
        "type": "way",
        "ref": number,
        "role": role,
        "geometry": way(number, points_m, closed=closed)["geometry"],
    }


def test_ways_and_relations_of_overpass():
    block, yard = square(20, 20, 40), square(30, 30, 20)
    relation = {
        "type": "relation",
        "id": 9,
        "tags": {"type": "multipolygon", "building": "yes", "height": "20"},
        "members": [
            member(1, block[:3], "outer", closed=False),
            member(2, [block[2], block[3], block[0]], "outer", closed=False),
            member(3, yard, "inner"),
        ],
    }
    group = {
        "type": "relation",
        "id": 10,
        "tags": {"type": "building", "building": "yes"},
        "members": [member(4, square(70, 10), "outline")],
    }
    elements = [
        relation,
        group,
        way(4, square(70, 10), building="yes", **{"building:levels": "2"}),
        way(5, square(0, 0, 100), landuse="residential"),
        {"type": "node", "id": 1, "lat": 47.37, "lon": 8.54, "tags": {"building": "yes"}},
    ]
    city, report = run({"version": 0.6, "elements": elements}, box=BOX)
    assert report.buildings == 2
    assert report.courtyards == 1
    assert city.is_free(np.array([40.0, 40.0, 5.0]), 9.9)
    assert set(city.obstacle_names) == {"relation/9", "relation/9 2", "way/4"}
    assert city.heights_m.tolist() == [20.0, 20.0, 6.0]


def test_ways_of_overpass_by_their_nodes():
    nodes = [
        {"type": "node", "id": index, "lon": lon, "lat": lat}
        for index, (lon, lat) in enumerate(degrees(square(20, 20)))
    ]
    house = {"type": "way", "id": 7, "nodes": [0, 1, 2, 3, 0], "tags": {"building": "yes"}}
    cut = {"type": "way", "id": 8, "nodes": [0, 1, 99, 0], "tags": {"building": "yes"}}
    _, report = run({"elements": [house, cut, *nodes]}, box=BOX)
    assert (report.buildings, report.without_area) == (1, 1)


@pytest.mark.parametrize(
    ("top", "message"),
    [
        ({"elements": 3}, "elements: expected an array"),
        ({"elements": [3]}, r"elements\[0\]: expected an object"),
        ({"elements": []}, "no features"),
        ({"elements": [], "remark": "runtime error: timed out"}, "did not finish: runtime error"),
        (
            {"elements": [{"type": "way", "id": 1, "nodes": [1], "tags": {"building": "yes"}}]},
            "carry no coordinates: end the Overpass query with `out geom;`",
        ),
        (
            {"elements": [way(1, square(0, 0)) | {"geometry": [{"lat": 3}]}]},
            r"elements\[0\]: lon None and lat 3 are no place",
        ),
        (
            {"elements": [{"type": "relation", "id": 1, "tags": {"building": "yes"}}]},
            r"elements\[0\].members: expected an array",
        ),
    ],
)
def test_answers_of_overpass_that_cannot_be_read(top, message):
    with pytest.raises(MapError, match=message):
        run(top)


# -- anything at all ----------------------------------------------------------------------------

SEEDS = [
    collection(feature(square(20, 20, 40), square(30, 30), height="9"), GOOD),
    {
        "elements": [
            way(1, square(20, 20), building="yes"),
            {
                "type": "relation",
                "id": 2,
                "tags": {"building": "yes"},
                "members": [member(3, square(50, 20), "outer")],
            },
        ]
    },
]
JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-200, 200),
    st.sampled_from([1e300, -1e300, 2**70, "", "x", "Feature", "Point", [], [[]], {}, [0, 0]]),
)


def places_in(value, path=()):
    yield path
    items = (
        value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0)
    )
    for key in items:
        inner = value[key]
        yield from places_in(inner, (*path, key))


@given(st.data())
def test_a_damaged_file_is_read_or_refused(data):
    top = json.loads(json.dumps(data.draw(st.sampled_from(SEEDS))))
    for _ in range(data.draw(st.integers(1, 3))):
        paths = [path for path in places_in(top) if path]
        path = data.draw(st.sampled_from(paths))
        inner = top
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = json.loads(json.dumps(data.draw(JUNK)))
    try:
        city, _ = run(top, box=BOX)
    except MapError:
        return
    assert len(city.obstacles) > 0
