"""Worlds whose observation shows the way round."""

import numpy as np
import pytest

from companion.policy.action import TARGET_SCALING, action_to_velocity_mps, bearing_to_target_rad
from companion.policy.observation import RAYS, WAYS, build_observation
from companion.world.maps import build_map
from companion.world.way_ahead import Ways
from companion.world.ways import RENEW_M, WayField, WayGrid, finish
from sim.dynamics import VelocityLag
from sim.guides import Surveyor
from sim.motion import Dynamics
from sim.world import CityWorld

WALL = [[28, 0], [32, 0], [32, 40], [28, 40]]
CITY = build_map("wall", (60, 60, 30), [WALL], [30.0])
OTHER = build_map("other", (60, 60, 30), [[[10, 20], [50, 20], [50, 24], [10, 24]]], [25.0])
STILL = {"dynamics": Dynamics(lag=VelocityLag()), "step_s": 0.5}


def make_world(maps=CITY, count=6, seed=0, **options):
    rng = np.random.default_rng(seed)
    return CityWorld(maps, WAYS, TARGET_SCALING, count, rng, **STILL | options)


def actions(steps, count, seed=3):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, count, 3))


@pytest.mark.parametrize("options", [{}, {"target_motion": "moving"}, {"targets_per_map": 5}])
def test_the_view_and_the_action_are_turned_to_the_aim(options):
    world = make_world(count=3, **options)
    before = world.reset()
    grid = finish(WayGrid.build(CITY))
    for action in actions(4, 3):
        position, target, aim = world.position_enu_m, world.target_enu_m, world.aim_enu_m
        bearing = bearing_to_target_rad(position, aim)
        wanted = action_to_velocity_mps(action, TARGET_SCALING, 5.0, bearing)
        if "target_motion" not in options:
            for row in range(3):
                ways = Ways([grid], np.array([0]))
                ways.put(0, finish(WayField.spread(grid, target[row])))
                ahead = ways.ahead(np.array([0]), position[row][None], target[row][None]).take(0)
                np.testing.assert_array_equal(aim[row], ahead.aim_enu_m)
                seen = build_observation(
                    WAYS,
                    position_enu_m=position[row],
                    velocity_enu_mps=world.velocity_enu_mps[row],
                    target_enu_m=target[row],
                    map=CITY,
                    ahead=ahead,
                )
                np.testing.assert_array_equal(before[row], seen)
        twin = make_world(count=3, **options)
        twin.load_state_dict(world.state_dict())
        before = world.step(action).observation
        np.testing.assert_array_equal(twin.follow(wanted).observation, before)


@pytest.mark.parametrize("options", [{}, {"target_motion": "moving"}, {"targets_per_map": 5}])
def test_a_saved_world_goes_on_to_the_same_result(options):
    world, other = make_world(**options, horizon=8), make_world(**options, horizon=8, seed=0)
    for action in actions(10, 6):
        world.step(action)
    other.load_state_dict(world.state_dict())
    for action in actions(12, 6, seed=4):
        one, same = world.step(action), other.step(action)
        np.testing.assert_array_equal(one.observation, same.observation)
        np.testing.assert_array_equal(one.reward, same.reward)


def test_worlds_taken_out_go_on_as_if_nothing_had_happened():
    whole, rows = make_world([CITY, OTHER]), np.array([1, 4, 5])
    for action in actions(3, 6):
        whole.step(action)
    taken = whole.take(rows)
    for action in actions(8, 6, seed=4):
        expected, result = whole.step(action), taken.step(action[rows])
        np.testing.assert_allclose(result.observation, expected.observation[rows], atol=1e-6)


def test_targets_come_from_the_pool_and_go_on_coming():
    world = make_world([CITY, OTHER], 40, targets_per_map=3, horizon=2)
    seen = {row: set() for row in range(40)}
    for action in actions(40, 40):
        world.step(action)
        for row, target in enumerate(world.target_enu_m):
            seen[row].add(target.tobytes())
    assert {len(targets) for targets in seen.values()} == {3}
    assert len(set.union(*seen.values())) == 6


def test_the_way_to_a_moving_target_is_renewed():
    world = make_world(target_motion="moving", target_speed=(0.4, 0.4), horizon=1000)
    first = world.target_enu_m
    for action in np.zeros((60, 6, 3)):
        world.step(action)
        led_to = world.state_dict()["arrays"]["led_to_enu_m"]
        assert np.linalg.norm(led_to - world.target_enu_m, axis=1).max() <= RENEW_M
    assert (led_to != first).any()


def test_hovering_before_a_wall_pays_less_than_the_way_round():
    def reward_at(position):
        world = make_world(count=1)
        state = world.state_dict()
        state["arrays"]["target_enu_m"][:] = [40.0, 10.0, 15.0]
        state["arrays"]["led_to_enu_m"][:] = [40.0, 10.0, 15.0]
        state["arrays"]["path_vertex_enu_m"][:] = [40.0, 10.0, 15.0]
        state["arrays"]["position_enu_m"][:] = position
        state["arrays"]["velocity_enu_mps"][:] = 0.0
        world.load_state_dict(state)
        return float(world.step(np.array([[-1.0, 0.0, 0.0]])).reward[0])

    before_the_wall, at_its_end = reward_at([24.0, 10.0, 15.0]), reward_at([30.0, 45.0, 15.0])
    assert at_its_end > before_the_wall


def test_a_surveyor_is_asked_once_for_the_same_cases():
    surveyor = Surveyor()
    first = make_world(surveyor=surveyor)
    before = dict(surveyor._fields)
    again = make_world(surveyor=surveyor)
    assert surveyor._fields == before
    np.testing.assert_array_equal(first.reset(), again.reset())


def test_a_pool_is_for_static_targets():
    with pytest.raises(ValueError, match="static"):
        make_world(targets_per_map=3, target_motion="moving")


def test_layouts_without_the_way_find_none():
    world = CityWorld(CITY, RAYS, TARGET_SCALING, 4, np.random.default_rng(0), **STILL)
    np.testing.assert_array_equal(world.aim_enu_m, world.target_enu_m)
