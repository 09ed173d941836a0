"""The layout ``ways``: the way round and what surrounds the vehicle, turned toward the next leg."""

import numpy as np
import pytest

from companion.policy.observation import NUM_RAYS, WAYS, build_observation
from companion.world.maps import build_map
from companion.world.way_ahead import WayAhead

WALL = np.array([[60.0, 10.0], [64.0, 10.0], [64.0, 90.0], [60.0, 90.0]])
CITY = build_map("wall", [100, 100, 80], [WALL], [50.0])


def see(position, target, ahead, velocity=(0.0, 0.0, 0.0)):
    return build_observation(
        WAYS,
        position_enu_m=np.asarray(position, dtype=np.float64),
        velocity_enu_mps=np.asarray(velocity, dtype=np.float64),
        target_enu_m=np.asarray(target, dtype=np.float64),
        map=CITY,
        ahead=ahead,
    )


def way(aim, beyond, left):
    return WayAhead(np.array(aim), np.array(beyond), np.array(left), np.array(True))


def columns(*args, **options):
    return dict(zip(WAYS.columns, see(*args, **options), strict=True))


def test_the_next_leg_lies_ahead_and_the_target_where_it_is():
    ahead = way([50.0, 92.0, 20.0], [60.0, 94.0, 25.0], 104.0)
    seen = columns([50.0, 50.0, 20.0], [80.0, 50.0, 30.0], ahead, velocity=[1.0, 2.0, -0.5])
    assert seen["aim_ahead"] == pytest.approx(0.42), "the end of the wall in the north"
    assert (seen["aim_up"], seen["aim_polar_sin"], seen["aim_polar_cos"]) == pytest.approx(
        (0, 1, 0)
    )
    assert seen["turn_ahead"] == pytest.approx(2.0 / 25.0)
    assert seen["turn_left"] == pytest.approx(-10.0 / 25.0), "then to the right"
    assert seen["turn_up"] == pytest.approx(0.2)
    assert seen["target_ahead"] == pytest.approx(0.0, abs=1e-6)
    assert seen["target_left"] == pytest.approx(-0.3)
    assert seen["target_up"] == pytest.approx(0.1)
    assert seen["distance"] == pytest.approx(np.sqrt(0.1))
    assert seen["way_left"] == pytest.approx(0.52)
    assert (seen["height"], seen["headroom"]) == pytest.approx((0.2, 0.6))
    assert seen["floor"] == pytest.approx(20.0 / 25.0)
    assert seen["velocity_ahead"] == pytest.approx(0.2)
    assert seen["velocity_left"] == pytest.approx(-0.1)
    assert seen["velocity_up"] == pytest.approx(-0.05)


def test_rays_start_at_the_aim_and_tell_near_walls_finely():
    seen = columns(
        [55.0, 50.0, 20.0], [80.0, 50.0, 20.0], way([55.0, 92.0, 20.0], [60, 94, 20], 90.0)
    )
    assert seen["wall_18"] == pytest.approx(0.5), "5 m to the right"
    assert seen["roof_18"] == pytest.approx(0.3)
    assert seen["wall_00"] == pytest.approx(50.0 / 55.0), "free ahead"
    nearer = columns(
        [57.0, 50.0, 20.0], [80.0, 50.0, 20.0], way([57.0, 92.0, 20.0], [60, 94, 20], 90)
    )
    assert nearer["wall_18"] == pytest.approx(3.0 / 8.0)


def test_without_a_known_way_the_target_lies_ahead():
    position, target = np.array([20.0, 20.0, 20.0]), np.array([50.0, 60.0, 20.0])
    seen = columns(position, target, WayAhead.straight(position, target))
    assert seen["aim_ahead"] == seen["target_ahead"] == pytest.approx(0.5)
    assert seen["target_left"] == pytest.approx(0.0, abs=1e-6)
    assert seen["way_left"] == pytest.approx(0.25)
    assert seen["turn_ahead"] == seen["turn_left"] == seen["turn_up"] == 0.0


def test_batches_equal_rows():
    rng = np.random.default_rng(1)
    position, target, aim, beyond = rng.uniform(0.0, 80.0, (4, 5, 3))
    ahead = WayAhead(aim, beyond, rng.uniform(0.0, 200.0, 5), np.ones(5, dtype=bool))
    batch = see(position, target, ahead, np.zeros_like(position))
    assert batch.shape == (5, len(WAYS.fields)) == (5, 18 + 2 * NUM_RAYS)
    np.testing.assert_array_equal(batch[3], see(position[3], target[3], ahead.take(3)))


def test_the_way_must_be_given():
    with pytest.raises(ValueError, match="way ahead"):
        see([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None)
