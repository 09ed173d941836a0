"""The piece of a large map around a vehicle answers as the whole map does."""

import numpy as np
import pytest

from companion.policy.observation import RAYS, build_observation
from companion.world.maps import build_map
from companion.world.neighbourhood import REACH_M, STRIDE_M, Neighbourhood

CORNER = np.array([(0, 0), (30, 0), (30, 12), (12, 12), (12, 28), (0, 28)])
SHED = np.array([(0, 0), (20, 0), (20, 20), (0, 20)])
SPIRE = np.array(
    [(10 + 9 * np.cos(t), 10 + 9 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 24, False)]
)


@pytest.fixture(scope="module")
def town():
    """A kilometre of streets, and one wall through all of it."""
    rng = np.random.default_rng(4)
    footprints = [
        (CORNER, SHED, SPIRE)[(east + 2 * north) % 3] + (50 * east + 6, 50 * north + 6)
        for east in range(20)
        for north in range(20)
        if north != 7
    ]
    footprints.append(np.array([(0, 352), (1000, 390), (1000, 392), (0, 354)]))
    return build_map("town", (1000, 1000, 100), footprints, rng.uniform(5, 70, len(footprints)))


def places(town, count=60):
    position_m = np.random.default_rng(5).uniform((0, 0, 1), (1000, 1000, 60), (20 * count, 3))
    return position_m[town.is_free(position_m, 0.1)][:count]


def test_rays_distances_and_ways_are_those_of_the_whole_map(town):
    piece = Neighbourhood(town)
    for position_m in places(town):
        here = piece.around(position_m)
        assert len(here.obstacles) < len(town.obstacles) / 3
        target_m = np.array([900.0, 100.0, 20.0])
        seen, wanted = (
            build_observation(
                RAYS,
                position_enu_m=position_m,
                velocity_enu_mps=np.array([1.0, 2.0, 0.0]),
                target_enu_m=target_m,
                map=city,
            )
            for city in (here, town)
        )
        np.testing.assert_array_equal(seen, wanted)
        near, far = here.obstacles, town.obstacles
        assert near.signed_distance_m(position_m) == far.signed_distance_m(position_m)
        np.testing.assert_array_equal(
            near.nearest_surface(position_m), far.nearest_surface(position_m)
        )
        ends_m = position_m + REACH_M * np.array([[0.7, 0.7, 0], [-1, 0, -0.05], [0, -1, 0.1]])
        np.testing.assert_array_equal(
            near.crash_depth_m(position_m, ends_m), far.crash_depth_m(position_m, ends_m)
        )
        assert near.floor_m(position_m) == far.floor_m(position_m)


def test_everything_within_reach_is_there_however_the_vehicle_moves(town):
    piece = Neighbourhood(town)
    position_m = np.array([500.0, 500.0, 80.0])
    rng = np.random.default_rng(6)
    for _ in range(300):
        position_m[:2] = np.clip(position_m[:2] + rng.uniform(-30, 30, 2), 0, 1000)
        here = piece.around(position_m)
        near = [
            name
            for name, footprint_m in zip(town.obstacle_names, town.footprints_m, strict=True)
            if np.linalg.norm(
                np.clip(position_m[:2], footprint_m.min(axis=0), footprint_m.max(axis=0))
                - position_m[:2]
            )
            <= REACH_M
        ]
        assert set(near) <= set(here.obstacle_names)
        assert len(here.footprints_m) == len(here.heights_m) == len(here.obstacles)


def test_it_is_the_same_map_in_frame_size_and_name(town):
    here = Neighbourhood(town).around(np.array([500.0, 500.0, 20.0]))
    assert (here.name, here.content_hash, here.edge_m) == (
        town.name,
        town.content_hash,
        town.edge_m,
    )
    np.testing.assert_array_equal(here.size_m, town.size_m)
    index = town.obstacle_names.index(here.obstacle_names[3])
    assert here.heights_m[3] == town.heights_m[index]
    np.testing.assert_array_equal(here.footprints_m[3], town.footprints_m[index])


def test_it_is_cut_anew_only_far_from_its_middle(town):
    piece = Neighbourhood(town)
    first = piece.around(np.array([300.0, 300.0, 20.0]))
    assert piece.around(np.array([300.0 + STRIDE_M, 300.0 - STRIDE_M, 90.0])) is first
    assert piece.around(np.array([300.0, 301.0 + STRIDE_M, 20.0])) is not first


def test_a_small_map_and_a_place_that_is_none_need_no_piece(town):
    small = build_map("small", (300, 300, 50), [SHED], [10.0])
    assert Neighbourhood(small).around(np.array([10.0, 10.0, 5.0])) is small
    piece = Neighbourhood(town)
    nowhere = np.array([np.nan, 3.0, 5.0])
    assert piece.around(nowhere) is town
    here = piece.around(np.array([10.0, 10.0, 5.0]))
    assert piece.around(nowhere) is here


def test_open_country_has_nothing_near():
    country = build_map("country", (2000, 2000, 100), [SHED], [10.0])
    here = Neighbourhood(country).around(np.array([1500.0, 1500.0, 20.0]))
    assert len(here.obstacles) == 0
    assert here.obstacles.signed_distance_m(np.array([1500.0, 1500.0, 20.0])) == np.inf
    wall_m, _ = here.obstacles.horizontal_rays(np.array([1500.0, 1500.0, 2.0]), np.zeros(3), 50.0)
    np.testing.assert_array_equal(wall_m, 50.0)
