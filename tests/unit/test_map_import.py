"""Building footprints to maps: what is kept, what is dropped and counted, what is refused."""

import json

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import MapError
from companion.world.building_file import read_outlines
from companion.world.frames import GeoPoint, enu_to_geodetic, geodetic_to_enu
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
    near = feature(square(10, 10))
    far = feature(square(20, 20), corner=antipode)
    wide = feature(square(20, 20)) | {"geometry": {"type": "Polygon", "coordinates": [fiji]}}
    _, report = run(collection(near, far, wide), box=BOX)
    assert (report.buildings, report.outside) == (1, 2)
    with pytest.raises(MapError, match="antimeridian"):
        run(collection(wide))
    with pytest.raises(MapError, match="choose it with --box or --center"):
        run(collection(near, feature(square(0, 0), corner=GeoPoint(48.0, 8.0, 0.0))))
