"""Rays and the floor below against shapely, and on the borders."""

import math

import numpy as np
import pytest
import shapely

from companion.world.geometry import Obstacles

SQUARE = np.array([[2.0, 2.0], [6.0, 2.0], [6.0, 6.0], [2.0, 6.0]])
HEIGHT_M = 5.0


@pytest.mark.parametrize("seed", range(12))
def test_rays_agree_with_shapely(random_city, seed):
    footprints, heights = random_city(seed)
    obstacles = Obstacles(footprints, heights)
    polygons = [shapely.Polygon(footprint) for footprint in footprints]
    rng = np.random.default_rng(seed)
    point, azimuth = rng.uniform(0.0, 100.0, (40, 3)), rng.uniform(-7.0, 7.0, (40, 9))
    range_m = 45.0
    distance, roof = obstacles.horizontal_rays(point, azimuth, range_m)
    for i, j in np.ndindex(azimuth.shape):
        place = shapely.Point(point[i, :2])
        tip = point[i, :2] + range_m * np.array([math.cos(azimuth[i, j]), math.sin(azimuth[i, j])])
        ray = shapely.LineString([point[i, :2], tip])
        seen = [
            (place.distance(cut), height)
            for polygon, height in zip(polygons, heights, strict=True)
            if height >= point[i, 2] and not (cut := polygon.intersection(ray)).is_empty
        ]
        expected = min((d for d, _ in seen), default=range_m)
        assert distance[i, j] == pytest.approx(expected, abs=1e-7)
        roofs = {height for d, height in seen if d < expected + 1e-7} or {0.0}
        assert roof[i, j] in roofs


@pytest.mark.parametrize(
    ("point", "azimuth", "range_m", "distance", "roof"),
    [
        pytest.param([0, 4, 3], 0.0, 9.0, 2.0, 5.0, id="east"),
        pytest.param([4, 0, 3], math.pi / 2, 9.0, 2.0, 5.0, id="north is a quarter turn"),
        pytest.param([9, 4, 3], math.pi, 9.0, 3.0, 5.0, id="west"),
        pytest.param([0, 4, 3], math.pi, 9.0, 9.0, 0.0, id="looking away"),
        pytest.param([0, 4, 3], 0.0, 2.0, 2.0, 5.0, id="exactly at range"),
        pytest.param([0, 4, 3], 0.0, 1.999, 1.999, 0.0, id="just out of range"),
        pytest.param([0, 4, 5], 0.0, 9.0, 2.0, 5.0, id="at the roof's height"),
        pytest.param([0, 4, 5.001], 0.0, 9.0, 9.0, 0.0, id="over the roof"),
        pytest.param([4, 4, 3], 0.0, 9.0, 0.0, 5.0, id="from inside"),
        pytest.param([2, 4, 3], math.pi, 9.0, 0.0, 5.0, id="on a wall, looking away"),
        pytest.param([0, 0, 0], math.pi / 4, 9.0, math.sqrt(8.0), 5.0, id="into the edge"),
    ],
)
def test_rays_on_the_borders(point, azimuth, range_m, distance, roof):
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    seen = obstacles.horizontal_rays(np.array(point), np.array([azimuth]), range_m)
    assert seen[0] == pytest.approx(distance)
    assert seen[1] == roof


def test_the_nearer_wall_is_seen_and_the_higher_of_two():
    behind = SQUARE + np.array([10.0, 0.0])
    obstacles = Obstacles([behind, SQUARE, SQUARE], [9.0, 5.0, 7.0])
    distance, roof = obstacles.horizontal_rays(np.array([0.0, 4.0, 1.0]), np.array([0.0]), 50.0)
    assert (distance[0], roof[0]) == (2.0, 7.0)


@pytest.mark.parametrize("seed", range(5))
def test_floor_agrees_with_shapely(random_city, seed):
    footprints, heights = random_city(seed)
    polygons = [shapely.Polygon(footprint) for footprint in footprints]
    point = np.random.default_rng(seed).uniform(0.0, 100.0, (200, 3))
    floor = Obstacles(footprints, heights).floor_m(point)
    for place, height in zip(point, floor, strict=True):
        over = [h for p, h in zip(polygons, heights, strict=True) if p.covers(shapely.Point(place))]
        assert height == max(over, default=0.0)


def test_floor_includes_the_walls():
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    places = np.array([[2.0, 4.0, 9.0], [2.0 - 1e-9, 4.0, 9.0], [6.0, 6.0, 0.0], [4.0, 4.0, 1.0]])
    np.testing.assert_array_equal(obstacles.floor_m(places), [5.0, 0.0, 5.0, 5.0])
