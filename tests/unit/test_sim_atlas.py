import numpy as np
import pytest

from companion.world.maps import load_map
from sim.atlas import Atlas
from sim.cities import random_city

MAPS = [load_map("free"), *(random_city("test", number) for number in range(4))]
RNG = np.random.default_rng(0)
MAP_OF_ROW = RNG.integers(len(MAPS), size=300)
START, END = RNG.uniform(0.0, 100.0, (2, 300, 3))


def on_each_map(query):
    """Return what every row's own map answers, row by row."""
    return [query(MAPS[number].obstacles, row) for row, number in enumerate(MAP_OF_ROW)]


@pytest.fixture(scope="module")
def atlas():
    return Atlas.under(MAPS, MAP_OF_ROW)


def test_crash_depth(atlas):
    expected = on_each_map(lambda obstacles, i: obstacles.crash_depth_m(START[i], END[i]))
    assert np.count_nonzero(expected) > 50
    np.testing.assert_array_equal(atlas.crash_depth_m(START, END), expected)


def test_floor(atlas):
    expected = on_each_map(lambda obstacles, i: obstacles.floor_m(START[i]))
    assert np.count_nonzero(expected) > 30
    np.testing.assert_array_equal(atlas.floor_m(START), expected)


def test_rays(atlas):
    azimuth = RNG.uniform(-4.0, 4.0, (300, 7))
    expected = on_each_map(lambda obs, i: obs.horizontal_rays(START[i], azimuth[i], 40.0))
    distance_m, roof_m = atlas.horizontal_rays(START, azimuth, 40.0)
    np.testing.assert_array_equal(distance_m, [pair[0] for pair in expected])
    np.testing.assert_array_equal(roof_m, [pair[1] for pair in expected])
    assert (distance_m < 40.0).mean() > 0.2


def test_distances(atlas):
    expected = on_each_map(lambda obstacles, i: obstacles.signed_distance_m(START[i]))
    np.testing.assert_array_equal(atlas.signed_distance_m(START), expected)
    np.testing.assert_array_equal(atlas.contains(START), np.array(expected) <= 0.0)
    nearest = on_each_map(lambda obstacles, i: obstacles.nearest_surface(START[i]))
    np.testing.assert_array_equal(atlas.nearest_surface(START), nearest)


def test_some_of_the_rows(atlas):
    rows = RNG.permutation(300)[:40]
    taken = atlas.take(rows)
    whole = atlas.crash_depth_m(START, END)
    np.testing.assert_array_equal(taken.crash_depth_m(START[rows], END[rows]), whole[rows])
    np.testing.assert_array_equal(
        taken.signed_distance_m(START[rows]), atlas.signed_distance_m(START)[rows]
    )


def test_nothing_but_empty_maps():
    atlas = Atlas.under([MAPS[0], MAPS[0]], np.array([0, 1, 1]))
    assert len(atlas) == 0
    assert not atlas.crash_depth_m(START[:3], END[:3]).any()
    assert not atlas.floor_m(START[:3]).any()
    assert np.isinf(atlas.signed_distance_m(START[:3])).all()
