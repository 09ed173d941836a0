"""The layout ``rays``: what the vehicle sees around it, turned toward the target."""

import numpy as np
import pytest

from companion.policy.observation import NUM_RAYS, RAYS, build_observation
from companion.world.maps import build_map

WALL = np.array([[60.0, 10.0], [64.0, 10.0], [64.0, 90.0], [60.0, 90.0]])
SHED = np.array([[20.0, 70.0], [40.0, 70.0], [40.0, 80.0], [20.0, 80.0]])
CITY = build_map("two", [100, 100, 80], [WALL, SHED], [50.0, 30.0])


def see(position, target, velocity=(0.0, 0.0, 0.0), city=CITY):
    return build_observation(
        RAYS,
        position_enu_m=np.asarray(position, dtype=np.float64),
        velocity_enu_mps=np.asarray(velocity, dtype=np.float64),
        target_enu_m=np.asarray(target, dtype=np.float64),
        map=city,
    )


def columns(*args, **options):
    return dict(zip(RAYS.columns, see(*args, **options), strict=True))


def test_a_target_in_the_east_behind_a_wall():
    seen = columns([30.0, 50.0, 20.0], [90.0, 50.0, 65.0])
    assert seen["offset_ahead"] == pytest.approx(0.6)
    assert seen["offset_up"] == pytest.approx(0.45)
    assert seen["distance"] == pytest.approx(0.75)
    assert (seen["polar_sin"], seen["polar_cos"]) == pytest.approx((0.8, 0.6))
    assert (seen["height"], seen["headroom"]) == pytest.approx((0.2, 0.6))
    assert seen["floor"] == pytest.approx(0.2)
    assert seen["wall_00"] == pytest.approx(30.0 / 50.0)
    assert seen["roof_00"] == pytest.approx(0.3)
    assert seen["wall_06"] == pytest.approx(20.0 / 50.0), "north is to the left: the shed"
    assert seen["roof_06"] == pytest.approx(0.1)
    assert (seen["wall_12"], seen["roof_12"]) == (1.0, 0.0), "behind it is free"
    assert (seen["wall_18"], seen["roof_18"]) == (1.0, 0.0), "to the right, too"


def test_the_view_turns_with_the_target():
    seen = columns([30.0, 50.0, 20.0], [30.0, 95.0, 20.0])
    assert seen["wall_00"] == pytest.approx(20.0 / 50.0), "the shed is ahead"
    assert seen["wall_18"] == pytest.approx(30.0 / 50.0), "the wall is to the right"


def test_velocity_ahead_left_and_up():
    seen = columns([30.0, 50.0, 20.0], [30.0, 95.0, 20.0], velocity=[-3.0, 4.0, -1.0])
    assert seen["velocity_ahead"] == pytest.approx(0.4)
    assert seen["velocity_left"] == pytest.approx(0.3)
    assert seen["velocity_up"] == pytest.approx(-0.1)


def test_above_roofs_the_view_is_free_and_the_floor_is_the_roof():
    seen = columns([30.0, 75.0, 35.0], [30.0, 10.0, 35.0])
    assert seen["floor"] == pytest.approx(0.05)
    assert (seen["wall_06"], seen["roof_06"]) == pytest.approx((0.6, 0.15)), "the tall wall"
    assert (seen["wall_00"], seen["roof_00"]) == (1.0, 0.0)


def test_inside_an_obstacle_every_wall_is_here():
    seen = see([62.0, 50.0, 20.0], [90.0, 50.0, 20.0])
    np.testing.assert_array_equal(seen[11 : 11 + NUM_RAYS], 0.0)
    np.testing.assert_allclose(seen[11 + NUM_RAYS :], 0.3)


@pytest.mark.parametrize("angle_rad", [0.3, 1.9, -2.5])
def test_turning_the_world_changes_nothing(angle_rad):
    rng = np.random.default_rng(5)
    position = rng.uniform(20.0, 80.0, (200, 3)) * (1.0, 1.0, 0.7)
    target = rng.uniform(20.0, 80.0, (200, 3)) * (1.0, 1.0, 0.7)
    velocity = rng.uniform(-5.0, 5.0, (200, 3))
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    shift = np.array([150.0, 150.0])

    def turned(points):
        return np.concatenate(((points[..., :2] - 50.0) @ turn.T + shift, points[..., 2:]), axis=-1)

    flat = [np.append(o, np.zeros((len(o), 1)), axis=1) for o in CITY.footprints_m]
    other = build_map("turned", [300, 300, 80], [turned(o)[:, :2] for o in flat], CITY.heights_m)
    spun = np.concatenate((velocity[:, :2] @ turn.T, velocity[:, 2:]), axis=1)
    before = see(position, target, velocity)
    after = see(turned(position), turned(target), spun, city=other)
    # A ray that grazes a corner may fall on either side of it.
    differs = ~np.isclose(before, after, atol=1e-5)
    assert differs.mean() < 1e-3


def test_batches_equal_rows():
    rng = np.random.default_rng(1)
    position, target = rng.uniform(0.0, 80.0, (2, 5, 7, 3))
    batch = see(position, target, np.zeros_like(position))
    assert batch.shape == (5, 7, len(RAYS.fields))
    np.testing.assert_array_equal(batch[3, 4], see(position[3, 4], target[3, 4]))
    np.testing.assert_array_equal(
        see(position[0, 0], target, np.zeros(3))[2, 2], see(position[0, 0], target[2, 2])
    )
