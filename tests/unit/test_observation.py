"""Layouts: values against hand-made examples, bounds, batches, borders."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.policy.observation import (
    LAYOUTS,
    PAPER,
    RELATIVE,
    build_observation,
    describe_layout,
)
from companion.world.maps import load_map
from companion.world.way_ahead import WayAhead

FREE = load_map("free")
points = arrays(np.float64, (4, 3), elements=st.floats(0.0, 100.0))


def observe(layout, position, target):
    position, target = (np.asarray(point, dtype=np.float64) for point in (position, target))
    return build_observation(
        layout,
        position_enu_m=position,
        velocity_enu_mps=np.zeros_like(position),
        target_enu_m=target,
        map=FREE,
        ahead=WayAhead.straight(position, target) if layout.shows_way else None,
    )


def columns(layout, position, target):
    return dict(zip(layout.columns, observe(layout, position, target), strict=True))


def test_the_paper_layout_is_the_papers_state():
    np.testing.assert_allclose(
        observe(PAPER, [10, 20, 30], [40, 50, 63]), [0.1, 0.2, 0.3, 0.4, 0.5, 0.63], rtol=1e-6
    )


def test_relative_columns_of_a_target_to_the_north_and_above():
    seen = columns(RELATIVE, [50, 20, 0], [50, 60, 30])
    assert seen["position_east"] == pytest.approx(0.0)
    assert seen["position_north"] == pytest.approx(-0.6)
    assert seen["position_up"] == pytest.approx(-1.0)
    assert (seen["offset_east"], seen["offset_north"]) == pytest.approx((0.0, 0.4))
    assert seen["offset_up"] == pytest.approx(0.3)
    assert seen["distance"] == pytest.approx(0.5)
    assert (seen["bearing_sin"], seen["bearing_cos"]) == pytest.approx((1.0, 0.0))
    assert (seen["polar_sin"], seen["polar_cos"]) == pytest.approx((0.8, 0.6))


def test_a_target_straight_above_has_no_bearing():
    seen = columns(RELATIVE, [50, 50, 10], [50, 50, 40])
    assert (seen["bearing_sin"], seen["bearing_cos"]) == (0.0, 1.0)
    assert (seen["polar_sin"], seen["polar_cos"]) == (0.0, 1.0)


def test_at_the_target_there_is_no_direction_at_all():
    seen = columns(RELATIVE, [50, 50, 10], [50, 50, 10])
    assert seen["distance"] == 0.0
    assert (seen["bearing_sin"], seen["bearing_cos"]) == (0.0, 1.0)
    assert (seen["polar_sin"], seen["polar_cos"]) == (1.0, 0.0)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
@given(position=points, target=points)
def test_batches_equal_rows_and_stay_in_bounds(layout, position, target):
    batch = observe(layout, position, target)
    assert batch.dtype == np.float32
    assert batch.shape == (4, len(layout.fields))
    low, high = layout.bounds()
    assert ((low <= batch) & (batch <= high)).all()
    for index in range(4):
        np.testing.assert_array_equal(observe(layout, position[index], target[index]), batch[index])


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_far_outside_is_clipped_to_the_bounds(layout):
    low, high = layout.bounds()
    seen = observe(layout, [-500.0, 900.0, -3.0], [4000.0, -4000.0, 4000.0])
    assert ((low <= seen) & (seen <= high)).all()


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_a_position_that_is_not_finite_stays_visible(layout):
    assert np.isnan(observe(layout, [np.nan, 1.0, 1.0], [5.0, 5.0, 5.0])).any()


def test_one_target_may_serve_many_vehicles():
    position = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    batch = observe(RELATIVE, position, [7.0, 8.0, 9.0])
    np.testing.assert_array_equal(batch[1], observe(RELATIVE, position[1], [7.0, 8.0, 9.0]))


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_column_names_are_unique_and_described(layout):
    assert len(set(layout.columns)) == len(layout.columns)
    text = describe_layout(layout)
    assert all(column in text for column in layout.columns)
    assert max(len(line) for line in text.splitlines()) <= 80
