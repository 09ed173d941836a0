"""Heights as people write them."""

import pytest

from companion.world.building_tags import (
    HeightSource,
    begins_above_ground,
    height_of,
    is_building,
    is_underground,
    parse_length_m,
    read_tags,
)


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
        ("12-15 m", 15.0),
        ("9,125", 9.125),
        ("1,250 ft", 381.0),
        ("12-", None),
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
        ({"height": "60", "min_height": "20"}, 60.0, HeightSource.GIVEN),
        ({"height": "10", "min_height": "30"}, 40.0, HeightSource.GIVEN),
        ({"min_height": "30"}, 45.0, HeightSource.ASSUMED),
        ({"building:levels": "8", "building:min_level": "4"}, 24.0, HeightSource.LEVELS),
        ({"building:levels": "2", "building:min_level": "4"}, 18.0, HeightSource.LEVELS),
        ({"height": "12", "base_height": "400"}, 12.0, HeightSource.GIVEN),
    ],
)
def test_the_height_of_a_building(properties, height_m, source):
    height = height_of(read_tags(properties), 15.0)
    assert (height.height_m, height.source) == (height_m, source)


def test_truth_values_and_spellings_of_exporters():
    assert is_building(read_tags({"building": True}))
    assert not is_building(read_tags({"building": False}))
    assert is_underground(read_tags({"is_underground": True}))
    assert not is_underground(read_tags({"is_underground": False}))
    assert begins_above_ground(read_tags({"base_height": "4.5"}))
    assert not begins_above_ground(read_tags({"base_height": "0"}))
    assert height_of(read_tags({"nb_floors": 4}), 15.0).height_m == 12.0
