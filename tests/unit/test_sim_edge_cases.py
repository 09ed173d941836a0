"""The edge cases: each is what it says, and a way leads there."""

import numpy as np
import pytest

from companion.policy.action import TARGET_SCALING
from companion.policy.observation import RELATIVE
from companion.world.way_ahead import Ways
from companion.world.ways import WayField, WayGrid, finish
from sim.edge_cases import edge_cases
from sim.world import CityWorld

CASES = edge_cases()
MARGIN_M = 2.0
every_case = pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])


def target_m(case, time_s=0.0):
    return case.target.at(np.array([time_s]))[0]


@every_case
def test_starts_and_targets_are_free_and_a_way_leads_from_each_to_each(case):
    assert case.city.is_free(case.start_enu_m, MARGIN_M).all()
    assert case.city.is_free(case.target.vertex_enu_m).all()
    grid = finish(WayGrid.build(case.city))
    ways = Ways([grid], np.zeros(1, dtype=np.int64))
    ways.put(0, finish(WayField.spread(grid, target_m(case)[0])))
    count = len(case.start_enu_m)
    field = np.zeros(count, dtype=np.int64)
    length_m = ways.length_m(field, case.start_enu_m, np.repeat(target_m(case), count, axis=0))
    assert np.isfinite(length_m).all()


@every_case
def test_most_starts_do_not_see_the_target(case):
    """Nor, where it moves, does any see it all the time."""
    to_m = case.target.vertex_enu_m[0][:, None]
    depth_m = case.city.obstacles.crash_depth_m(*np.broadcast_arrays(case.start_enu_m, to_m))
    assert np.mean(depth_m.max(axis=0) > 0.0) >= 0.5


def test_the_target_moves_through_the_gate_and_the_others_rest():
    moving = {case.name: float(case.target.speed_mps[0]) for case in CASES}
    assert [name for name, speed_mps in moving.items() if speed_mps > 0.0] == ["through a gate"]
    gate = next(case for case in CASES if case.name == "through a gate")
    north_m = [target_m(gate, time_s)[0, 1] for time_s in range(60)]
    assert min(north_m) < 30.0 < 70.0 < max(north_m)
    crossed = gate.city.obstacles.crash_depth_m(*gate.target.vertex_enu_m[0])
    assert crossed == 0.0


@every_case
def test_a_case_begins_at_all_starts_in_turn(case):
    starts = len(case.start_enu_m)
    world = CityWorld(case.city, RELATIVE, TARGET_SCALING, 2 * starts, np.random.default_rng(1))
    observation = case.begin(world)
    np.testing.assert_array_equal(world.position_enu_m, np.tile(case.start_enu_m, (2, 1)))
    np.testing.assert_array_equal(world.target_enu_m, np.repeat(target_m(case), 2 * starts, axis=0))
    np.testing.assert_array_equal(observation[:starts], observation[starts:])
    world.step(np.full((2 * starts, 3), [-1.0, 0.0, 0.0]))
    np.testing.assert_allclose(world.target_enu_m[0], target_m(case, world.dt_s)[0], atol=1e-9)
