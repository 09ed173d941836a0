"""Targets beyond the horizon are brought near; those within it stay what they are."""

import numpy as np
import pytest

from companion.policy.horizon import BROUGHT_TO_M, HORIZON_M, way_within_horizon, within_horizon
from companion.policy.observation import RAYS, build_observation
from companion.world.maps import build_map
from companion.world.way_ahead import WayAhead

HERE = np.array([100.0, 200.0, 20.0])


def at(*offset_m):
    return HERE + np.array(offset_m)


@pytest.mark.parametrize("offset", [(0, 0, 0), (3, -4, 60), (0, 0, 300), (HORIZON_M, 0, -10)])
def test_a_target_within_the_horizon_is_itself(offset):
    target_m = HERE + offset
    np.testing.assert_array_equal(within_horizon(HERE, target_m), target_m)


def test_a_target_far_off_lies_on_the_straight_way_at_the_horizon():
    target_m = at(1200.0, -900.0, 75.0)
    near_m = within_horizon(HERE, target_m)
    np.testing.assert_allclose(
        near_m - HERE, BROUGHT_TO_M * np.array([0.8, -0.6, 0.05]), atol=1e-12
    )


def test_rows_are_alone_and_a_nan_stays_one():
    targets_m = HERE + np.array([(10.0, 0.0, 0.0), (0.0, 500.0, 0.0), (np.nan, 0.0, 0.0)])
    near_m = within_horizon(HERE, targets_m)
    np.testing.assert_array_equal(near_m[0], targets_m[0])
    np.testing.assert_allclose(near_m[1], at(0.0, BROUGHT_TO_M, 0.0))
    assert np.isnan(near_m[2, 0])


def test_a_way_round_keeps_what_it_costs():
    target_m = at(1000.0, 0.0, 0.0)
    aim_m = at(0.0, 30.0, 5.0)
    way = WayAhead(aim_m, at(20.0, 30.0, 5.0), np.array(1040.0), np.array(True))
    near = way_within_horizon(HERE, target_m, way)
    np.testing.assert_array_equal(near.aim_enu_m, aim_m)
    np.testing.assert_array_equal(near.beyond_enu_m, way.beyond_enu_m)
    assert near.left_m == pytest.approx(BROUGHT_TO_M + 40.0)
    assert near.known


def test_without_a_way_the_aim_comes_near_as_the_target_does():
    target_m = at(1000.0, 0.0, 50.0)
    near = way_within_horizon(HERE, target_m, WayAhead.straight(HERE, target_m))
    np.testing.assert_array_equal(near.aim_enu_m, within_horizon(HERE, target_m))
    assert near.left_m == pytest.approx(np.hypot(BROUGHT_TO_M, 0.05 * BROUGHT_TO_M))
    assert not near.known


def test_the_observation_shows_a_far_target_within_the_training():
    city = build_map("country", (4000.0, 4000.0, 100.0), [], [])
    seen = build_observation(
        RAYS,
        position_enu_m=at(0.0, 0.0, 0.0),
        velocity_enu_mps=np.zeros(3),
        target_enu_m=at(3000.0, 0.0, 60.0),
        map=city,
    )
    shown = dict(zip(RAYS.columns, seen.tolist(), strict=True))
    assert shown["offset_ahead"] == pytest.approx(0.9)
    assert shown["offset_up"] == pytest.approx(0.018)
