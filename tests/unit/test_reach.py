"""Tests of training.reach."""

import numpy as np
import pytest

from companion.policy.action import TARGET_SCALING
from companion.policy.observation import RELATIVE
from companion.world.maps import build_map
from sim.world import CityWorld
from training.reach import out_of_reach

WALL = ((0.0, 40.0), (100.0, 40.0), (100.0, 45.0), (0.0, 45.0))
SLIT = ((20.0, 60.0), (60.0, 60.0), (60.0, 80.0), (20.0, 80.0))
BESIDE = ((20.0, 83.0), (60.0, 83.0), (60.0, 95.0), (20.0, 95.0))


def is_out_of_reach(footprints, heights_m, target_enu_m, start_enu_m=(50.0, 20.0, 30.0)):
    city = build_map("city", (100.0, 100.0, 100.0), footprints, heights_m)
    world = CityWorld(city, RELATIVE, TARGET_SCALING, 1, np.random.default_rng(0))
    world._motion.position_enu_m[0] = start_enu_m
    world._target_enu_m[0] = target_enu_m
    return bool(out_of_reach(world, margin_m=2.0, radius_m=5.0)[0])


@pytest.mark.parametrize("target", [(50, 50, 5), (1, 1, 1), (99, 99, 99), (50, 45.1, 20)])
def test_everything_is_in_reach_where_ways_lead_over_the_roofs(target):
    assert not is_out_of_reach([WALL], [90.0], target)


def test_what_lies_behind_a_wall_up_to_the_ceiling_is_not():
    assert is_out_of_reach([WALL], [97.0], (50.0, 70.0, 20.0))
    assert not is_out_of_reach([WALL], [97.0], (50.0, 30.0, 20.0))
    # Across the wall, but near enough to it.
    assert not is_out_of_reach([WALL], [97.0], (50.0, 37.0, 20.0))


def test_a_slit_narrower_than_two_margins_is_reached_from_above_only():
    assert is_out_of_reach([SLIT, BESIDE], [50.0, 50.0], (40.0, 81.5, 20.0))
    assert not is_out_of_reach([SLIT, BESIDE], [50.0, 50.0], (40.0, 81.5, 48.0))
    assert not is_out_of_reach([SLIT, BESIDE], [50.0, 50.0], (58.0, 81.5, 20.0))


def test_the_sides_of_the_map_count_as_walls():
    tower = ((0.0, 3.0), (30.0, 3.0), (30.0, 30.0), (0.0, 30.0))
    assert is_out_of_reach([tower], [60.0], (10.0, 1.0, 20.0), (50.0, 50.0, 50.0))
