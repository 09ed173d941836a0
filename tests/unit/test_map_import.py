"""Building footprints to maps: what is kept, what is dropped and counted, what is refused."""

import json

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import MapError
from companion.world.building_file import read_outlines
from companion.world.building_tags import HeightSource, height_of, parse_length_m, read_tags
from companion.world.frames import GeoPoint, enu_to_geodetic, geodetic_to_enu
from companion.world.holes import cut_holes
from companion.world.import_report import describe_import, warnings_of
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


# -- holes --------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
def test_polygons_without_holes_cover_the_same_ground(seed):
    rng = np.random.default_rng(seed)
    shape = shapely.box(0.0, 0.0, 100.0, 100.0)
    for _ in range(rng.integers(1, 6)):
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 9)))
        around = np.stack((np.cos(angle), np.sin(angle)), axis=1) * rng.uniform(1.0, 30.0)
        hole = shapely.Polygon(np.round(rng.uniform(-5.0, 105.0, 2) + around, rng.integers(0, 3)))
        shape = shape.difference(shapely.make_valid(hole))
    for polygon in shapely.get_parts(shapely.set_precision(shape, 0.01)):
        parts = [shapely.Polygon(part) for part in cut_holes(polygon)]
        assert all(part.is_valid for part in parts)
        assert sum(part.area for part in parts) == pytest.approx(polygon.area, abs=1e-6)
        assert shapely.union_all(parts).symmetric_difference(polygon).area < 1e-6
        corners = {corner for part in parts for corner in part.exterior.coords}
        assert corners <= set(shapely.get_coordinates(polygon).view("f8,f8").ravel().tolist())


def test_two_parts_are_enough_round_a_courtyard():
    outer, inner = square(0.0, 0.0, 30.0), square(10.0, 10.0)
    assert len(cut_holes(shapely.Polygon(outer, [inner]))) == 2
    (alone,) = cut_holes(shapely.Polygon(outer))
    assert alone.tolist() == [list(corner) for corner in outer]


@pytest.mark.parametrize(
    "holes",
    [
        pytest.param([[(5, 0), (7, 4), (3, 4)]], id="touches the outline"),
        pytest.param([[(2, 2), (5, 5), (2, 8)], [(5, 5), (8, 2), (8, 8)]], id="touch in a corner"),
        pytest.param(
            [[(2, 2), (6, 2), (6, 8), (2, 8)], [(6, 5), (8, 4), (8, 6)]], id="touch at a side"
        ),
    ],
)
def test_holes_that_touch(holes):
    polygon = shapely.Polygon(square(0, 0), holes)
    parts = [shapely.Polygon(part) for part in cut_holes(polygon)]
    assert all(part.is_valid for part in parts)
    assert sum(part.area for part in parts) == pytest.approx(polygon.area, abs=1e-9)


# -- heights ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "length_m"),
    [
        ("12", 12.0),
        ("12 m", 12.0),
        ("12.5m", 12.5),
        ("12,5 Metres", 12.5),
        ("40 ft", 12.192),
        ("40'", 12.192),
        ("7'4\"", 2.2352),
        ("7 ft 4 in", 2.2352),
        ("~12", 12.0),
        ("12; 15", 15.0),
        ("high", None),
        ("12 storeys", None),
        ("12;high", None),
        ("-3", None),
        ("", None),
    ],
)
def test_lengths_as_people_write_them(text, length_m):
    assert parse_length_m(text) == (None if length_m is None else pytest.approx(length_m))


@pytest.mark.parametrize(
    ("properties", "height_m", "source"),
    [
        ({"height": "12 m"}, 12.0, HeightSource.GIVEN),
        ({"height": 12}, 12.0, HeightSource.GIVEN),
        ({"HEIGHT": 12.5}, 12.5, HeightSource.GIVEN),
        ({"building:height": "12"}, 12.0, HeightSource.GIVEN),
        ({"building_height": "12"}, 12.0, HeightSource.GIVEN),
        ({"height": "12", "building:levels": "9"}, 12.0, HeightSource.GIVEN),
        ({"tags": {"height": "12"}}, 12.0, HeightSource.GIVEN),
        ({"other_tags": '"height"=>"12 m","x"=>"y"'}, 12.0, HeightSource.GIVEN),
        ({"building:levels": "4"}, 12.0, HeightSource.LEVELS),
        ({"building:levels": "4", "roof:levels": "1"}, 15.0, HeightSource.LEVELS),
        ({"building:levels": "4", "roof:levels": "1", "roof:height": "5"}, 17.0, "levels"),
        ({"num_floors": 4}, 12.0, HeightSource.LEVELS),
        ({"height": "tall", "building:levels": "4"}, 12.0, HeightSource.LEVELS),
        ({"height": -1.0}, 15.0, HeightSource.ASSUMED),
        ({"height": None}, 15.0, HeightSource.ASSUMED),
        ({"height": True}, 15.0, HeightSource.ASSUMED),
        ({}, 15.0, HeightSource.ASSUMED),
    ],
)
def test_the_height_of_a_building(properties, height_m, source):
    height = height_of(read_tags(properties), 15.0)
    assert (height.height_m, height.source) == (height_m, source)


def test_heights_are_counted():
    city, report = run(
        collection(
            feature(square(10, 10), height="12 m"),
            feature(square(30, 10), height="tall"),
            feature(square(50, 10), height="250"),
            feature(square(70, 10), **{"building:levels": "3", "min_height": "4"}),
            feature(square(10, 30), **{"building:part": "yes", "height": "33.333"}),
        ),
        box=BOX,
    )
    assert city.heights_m.tolist() == [12.0, 15.0, 100.0, 9.0, 33.34]
    assert report.heights == {"given": 3, "levels": 1, "assumed": 1}
    assert (report.unreadable_heights, report.capped, report.raised, report.parts) == (1, 1, 1, 1)


# -- ground -------------------------------------------------------------------------------------


def test_buildings_stand_where_they_stand_on_earth():
    place = GeoPoint(47.3705, 8.5406, 408.0)
    box = MapBox.around((47.3705, 8.5406), 120.0, 408.0)
    east_m, north_m, _ = geodetic_to_enu(box.origin, place)
    assert (east_m, north_m) == pytest.approx((60.0, 60.0), abs=2e-3)
    corner = GeoPoint(place.latitude_deg, place.longitude_deg, 408.0)
    city, _ = run(collection(feature(square(0, 0), corner=corner)), box=box, tolerance_m=0.0)
    np.testing.assert_allclose(
        city.footprints_m[0][np.lexsort(city.footprints_m[0].T)],
        [[60, 60], [70, 60], [60, 70], [70, 70]],
        atol=0.011,
    )
    assert city.origin == box.origin


@pytest.mark.parametrize("latitude_deg", [-60.0, -1.0, 0.0, 47.0, 80.0])
def test_a_box_holds_all_of_its_corners(latitude_deg):
    first, second = (latitude_deg + 0.01, 8.55), (latitude_deg, 8.54)
    box = MapBox.between(first, second, 400.0)
    low_deg, high_deg = box.bounds_deg
    assert low_deg == pytest.approx([8.54, latitude_deg], abs=2e-5)
    assert np.all(high_deg >= [8.55 - 1e-9, latitude_deg + 0.01 - 1e-9])
    assert box.north_m == pytest.approx(1111.0, abs=8.0)
    assert box == MapBox.between((first[0], second[1]), (second[0], first[1]), 400.0)


def test_without_a_box_all_buildings_are_on_the_map():
    city, report = run(collection(feature(square(0, 0)), feature(square(300, 200))))
    assert report.buildings == 2
    assert report.clipped == report.outside == 0
    assert city.size_m == pytest.approx([330.0, 230.0, 100.0], abs=1.01)
    low_m = np.min([footprint.min(axis=0) for footprint in city.footprints_m], axis=0)
    assert low_m == pytest.approx([10.0, 10.0], abs=0.02)


@given(st.integers(0, 2**32 - 1))
def test_what_is_in_the_box_is_kept_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    turn, shift = rng.uniform(0.0, np.pi), rng.uniform(-40.0, 110.0, 2)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    outer, inner = (np.array(square(-s / 2, -s / 2, s)) @ turned + shift for s in (40.0, 20.0))
    inside = shapely.Polygon(outer, [inner]).intersection(shapely.box(0.0, 0.0, 100.0, 80.0))
    try:
        city, _ = run(collection(feature(outer, inner)), box=BOX, tolerance_m=0.0)
    except MapError:
        assert inside.area < 3.0
        return
    kept = shapely.union_all([shapely.Polygon(footprint) for footprint in city.footprints_m])
    assert kept.symmetric_difference(inside).area < 3.0  # a centimetre along all of the outline
    assert all(np.all((f >= 0.0) & (f <= city.size_m[:2])) for f in city.footprints_m)


def test_a_courtyard_stays_open():
    top = collection(feature(square(20, 20, 40), square(30, 30, 20), height="20"))
    city, report = run(top, box=BOX)
    assert report.courtyards == 1
    assert city.is_free(np.array([40.0, 40.0, 5.0]), 9.9)
    assert not city.is_free(np.array([25.0, 40.0, 5.0]))
    ground = sum(shapely.Polygon(footprint).area for footprint in city.footprints_m)
    assert ground == pytest.approx(40.0**2 - 20.0**2, abs=1.0)


def test_what_is_dropped_is_counted():
    bowtie = [(60, 60), (70, 70), (70, 60), (60, 70)]
    city, report = run(
        collection(
            feature(square(10, 10), square(14, 14, 0.5)),
            feature(square(30, 10, 0.8)),
            feature(bowtie),
            feature([(1, 1), (5, 5), (9, 9)]),
            feature(square(-5, 50)),
            feature(square(500, 500)),
            feature(square(50, 10), location="underground"),
            feature(square(70, 10), building="no"),
            {"type": "Feature", "properties": {"building": "yes"}, "geometry": None},
            {
                "type": "Feature",
                "properties": {"building": "yes"},
                "geometry": {"type": "Point", "coordinates": [8.54, 47.37]},
            },
        ),
        box=BOX,
    )
    assert report.features == 10
    assert report.buildings == 3
    assert report.courtyards == 0
    assert report.courtyards_filled == 1
    assert (report.tiny, report.invalid, report.repaired, report.clipped) == (1, 1, 1, 1)
    assert (report.outside, report.underground, report.other_features) == (1, 1, 1)
    assert report.without_area == 2
    text = describe_import(city, report, 15.0)
    assert all(len(line) <= 80 for line in text.splitlines())
    for counted in ("cut off at the edge", "courtyards below 1 m2 filled", "outside the box"):
        assert f"1  {counted}" in text


def test_the_summary_fits_in_80_columns_whatever_the_numbers():
    name = "A house with a very long name, in a very long street"
    numbers = {"height": "99999 ft", "min_height": "3", "name": name, "building:part": "yes"}
    city, report = run(collection(feature(square(10, 10), **numbers)), box=BOX, name=name * 2)
    for counted in ("outside", "tiny", "invalid", "without_area", "unreadable_heights"):
        setattr(report, counted, 123456)
    text = describe_import(city, report, 15.0)
    assert len(max(text.splitlines(), key=len)) <= 80


def test_outlines_are_simplified_by_no_more_than_asked():
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    disc = np.stack((50.0 + 20.0 * np.cos(angle), 40.0 + 20.0 * np.sin(angle)), axis=1)
    corners = {}
    for tolerance_m in (0.0, 0.2, 1.0):
        city, _ = run(collection(feature(disc)), box=BOX, tolerance_m=tolerance_m)
        outline = shapely.Polygon(city.footprints_m[0])
        assert outline.hausdorff_distance(shapely.Polygon(disc)) < tolerance_m + 0.02
        corners[tolerance_m] = len(city.footprints_m[0])
    assert corners[0.0] == 90
    assert corners[0.2] < 40
    assert corners[1.0] < corners[0.2]


def test_multipolygons_and_names():
    parts = {
        "type": "MultiPolygon",
        "coordinates": [[ring(square(10, 10))], [ring(square(40, 10)), ring(square(43, 13, 4))]],
    }
    hall = {"building": "yes", "name": "Town\u202e Hall", "@id": "relation/7"}
    city, report = run(
        collection(
            {"type": "Feature", "properties": hall, "geometry": parts},
            feature(square(70, 10), name="Town Hall"),
            feature(square(70, 40), **{"@id": "way/5"}),
            feature(square(10, 40)),
        ),
        box=BOX,
    )
    assert report.buildings == 4
    assert city.obstacle_names == (
        "Town Hall", "Town Hall 2", "Town Hall 3", "Town Hall 4", "way/5", "building",
    )  # fmt: skip
    assert "OpenStreetMap" in city.description


def test_footprints_from_a_survey_have_no_tags():
    survey = collection(
        {"type": "Feature", "properties": {}, "geometry": feature(square(10, 10))["geometry"]},
        {"type": "Feature", "properties": None, "geometry": feature(square(30, 10))["geometry"]},
    )
    _, report = run(survey, box=BOX)
    assert report.buildings == 2
    assert report.untagged
    assert any("nothing is tagged" in warning for warning in warnings_of(report))
    for bare in (survey["features"][0], survey["features"][0]["geometry"]):
        assert run(bare, box=BOX)[1].buildings == 1


@pytest.mark.parametrize("separator", ["", "\x1e"])
def test_a_feature_a_line(separator):
    houses = [feature(square(10, 10)), feature(square(30, 10))]
    lines = "".join(f"{separator}{json.dumps(house)}\n" for house in houses)
    _, report = import_map(read_outlines(lines.encode()), ImportOptions("town", "town", box=BOX))
    assert report.buildings == 2
    with pytest.raises(MapError, match="not JSON"):
        read_outlines((lines + separator + "{").encode())


def test_swapped_coordinates_are_suspected():
    turn = 0.5
    houses = []
    for x in range(0, 100, 20):
        for y in range(0, 100, 20):
            corners = np.array(square(0, 0, 8.0)) @ [
                [np.cos(turn), np.sin(turn)],
                [-np.sin(turn), np.cos(turn)],
            ]
            houses.append(feature(corners + np.array([x, y])))
    assert not run(collection(*houses))[1].swapped
    for house in houses:
        rings = house["geometry"]["coordinates"]
        house["geometry"]["coordinates"] = [[place[::-1] for place in line] for line in rings]
    _, report = run(collection(*houses))
    assert report.swapped
    assert any("swapped" in warning for warning in warnings_of(report))
    with pytest.raises(MapError, match="with the two swapped 25 would be in it"):
        run(collection(*houses), box=MapBox.around((47.3704, 8.5406), 200.0, 0.0))


# -- refused ------------------------------------------------------------------------------------

GOOD = feature(square(10, 10))


def spoilt(coordinates):
    geometry = {"type": "Polygon", "coordinates": coordinates}
    return collection(GOOD, {"type": "Feature", "properties": {}, "geometry": geometry})


WRONG = {
    "empty": (b"", "the file is empty"),
    "no JSON": (b"{", "not JSON: Input data was truncated"),
    "not text": (b'{"a": "\xff"}', "not JSON"),
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
        "crs is urn:ogc:def:crs:EPSG::2056: only WGS84",
    ),
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


def test_crs_that_are_wgs84():
    for name in ("urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"):
        crs = {"type": "name", "properties": {"name": name}}
        assert run(collection(GOOD) | {"crs": crs}, box=BOX)[1].buildings == 1


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ((10.0, 179.999), (10.01, -179.999), "antimeridian"),
        ((84.999, 8.0), (85.001, 8.01), "reaches latitude 85.001"),
        ((-89.0, 8.0), (-89.001, 8.001), "latitude -89"),
        ((47.0, 8.0), (48.0, 8.1), "the box is 7583 x 111195 m: a map is 10 to 10000 m"),
        ((47.0, 8.0), (47.00001, 8.00001), "the box is 1 x 1 m"),
    ],
)
def test_boxes_that_no_map_can_have(first, second, message):
    with pytest.raises(MapError, match=message):
        MapBox.between(first, second, 0.0)


def test_buildings_round_the_earth_are_refused_or_outside():
    with pytest.raises(MapError, match="antimeridian"):
        MapBox.around((10.0, 179.9999), 200.0, 0.0)
    antipode = GeoPoint(-47.37, 8.54 - 180.0, 0.0)
    fiji = [[179.9, -17.0], [-179.9, -17.0], [-179.9, -17.1]]
    far = feature(square(20, 20), corner=antipode)
    wide = feature(square(20, 20)) | {"geometry": {"type": "Polygon", "coordinates": [fiji]}}
    _, report = run(collection(GOOD, far, wide), box=BOX)
    assert (report.buildings, report.outside) == (1, 2)
    with pytest.raises(MapError, match="antimeridian"):
        run(collection(wide))
    with pytest.raises(MapError, match="choose it with --box or --center"):
        run(collection(GOOD, feature(square(0, 0), corner=GeoPoint(48.0, 8.0, 0.0))))


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
