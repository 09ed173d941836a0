"""Polygons with holes, cut into simple ones: the same ground, nothing added."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from companion.world.holes import cut_holes


def square(x, y, side=10.0):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


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
