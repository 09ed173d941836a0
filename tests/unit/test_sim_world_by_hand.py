"""Steps of the world whose outcome is known without computing it twice."""

import math

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING
from sim.dynamics import VelocityLag, VerticalLimits
from sim.motion import Dynamics
from sim.reward import Reward
from tests.unit.world_bench import (
    EAST,
    NORTH,
    STAY,
    TOWER_AND_COURT,
    UP,
    make_world,
    place,
    random_actions,
    run,
)


@pytest.fixture
def city():
    return TOWER_AND_COURT


def test_a_crash_by_hand(city):
    world = make_world(city)
    place(world, [30.0, 50.0, 25.0], [90.0, 50.0, 25.0])
    result = world.step(EAST[None])

    np.testing.assert_allclose(result.position_enu_m, [[50.0, 50.0, 25.0]], atol=1e-12)
    np.testing.assert_allclose(result.crash_depth_m, [10.0], atol=1e-9)
    guidance, penalty = math.exp(-5.0 * 0.4**2), math.exp(-100.0 * 0.1) - 1.0
    np.testing.assert_allclose(result.reward, [0.2 * guidance + 0.8 * penalty], rtol=1e-12)
    np.testing.assert_allclose(result.next_observation, [[0.5, 0.5, 0.25, 0.9, 0.5, 0.25]])
    assert result.contact.tolist() == [True]
    assert result.reached.tolist() == [False]
    assert result.terminated.tolist() == [False]
    assert result.truncated.tolist() == [False]


def test_over_the_roof_is_free(city):
    world = make_world(city)
    place(world, [30.0, 50.0, 50.1], [90.0, 50.0, 50.1])
    result = world.step(EAST[None])
    assert result.crash_depth_m.tolist() == [0.0]
    np.testing.assert_allclose(result.reward, 0.2 * math.exp(-5.0 * 0.4**2))


def test_through_two_legs_of_a_courtyard(city):
    world = make_world(city, scaling=PAPER_SCALING)
    place(world, [69.0, 30.0, 10.0], [20.0, 90.0, 10.0])
    depth_m = world.step(EAST[None]).crash_depth_m[0] + world.step(EAST[None]).crash_depth_m[0]
    assert depth_m == pytest.approx(14.0)


def test_contact_terminates_when_asked(city):
    world = make_world(city, end_on_contact=True, horizon=1)
    place(world, [30.0, 50.0, 25.0], [90.0, 50.0, 25.0])
    result = world.step(EAST[None])
    assert result.terminated.tolist() == [True]
    assert result.truncated.tolist() == [False], "not both, even at the horizon"


def test_the_horizon_truncates_and_keeps_the_last_observation(city):
    world = make_world(city, horizon=3)
    place(world, [10.0, 10.0, 10.0], [30.0, 90.0, 90.0])
    results = run(world, [NORTH[None], NORTH[None], UP[None]])
    assert [bool(r.truncated[0]) for r in results] == [False, False, True]
    assert not any(r.terminated[0] for r in results)
    last = results[-1]
    np.testing.assert_allclose(last.next_observation[0], [0.1, 0.5, 0.3, 0.3, 0.9, 0.9], rtol=1e-6)
    assert not np.array_equal(last.observation, last.next_observation)
    np.testing.assert_allclose(last.observation[0, :3], world.position_enu_m[0] / 100.0, rtol=1e-6)
    assert last.episode_end.steps.tolist() == [3]


def test_before_an_end_both_observations_are_one(city):
    world = make_world(city, num_worlds=8)
    result = world.step(random_actions(1, 8)[0])
    np.testing.assert_array_equal(result.observation, result.next_observation)
    assert len(result.episode_end.world) == 0


def test_walls_are_slid_along(city):
    world = make_world(city)
    place(world, [95.0, 50.0, 70.0], [50.0, 10.0, 90.0])
    north_east = np.array([[1.0, 0.0, -0.75]])
    result = world.step(north_east)
    np.testing.assert_allclose(result.position_enu_m, [[100.0, 50.0 + 20.0 * math.sqrt(0.5), 70.0]])


def test_arrival_is_remembered_and_ends_nothing(city):
    world = make_world(city)
    place(world, [10.0, 50.0, 70.0], [28.0, 50.0, 70.0])
    results = run(world, [EAST[None], EAST[None], EAST[None]])
    assert [bool(r.reached[0]) for r in results] == [True, True, True]
    assert not any(r.truncated[0] or r.terminated[0] for r in results)


def test_arrival_truncates_when_asked(city):
    world = make_world(city, end_on_arrival=True)
    place(world, [10.0, 50.0, 70.0], [28.0, 50.0, 70.0])
    result = world.step(EAST[None])
    assert result.truncated.tolist() == [True]
    assert result.terminated.tolist() == [False]
    end = result.episode_end
    assert end.reached.tolist() == [True]
    assert end.min_distance_m[0] == pytest.approx(2.0)


@pytest.mark.parametrize(("gap_m", "reached"), [(4.999, True), (5.0, False)])
def test_the_arrival_radius_is_open(city, gap_m, reached):
    world = make_world(city)
    place(world, [10.0, 90.0, 70.0], [10.0 + gap_m, 90.0, 70.0])
    assert bool(world.step(STAY[None]).reached[0]) is reached


def test_no_arrival_after_a_contact(city):
    world = make_world(city, horizon=2)
    place(world, [30.0, 50.0, 25.0], [70.0, 50.0, 25.0])
    first, second = run(world, [EAST[None], EAST[None]])
    assert second.episode_end.distance_m[0] < 1e-9
    assert not second.reached[0]
    assert not second.episode_end.reached[0]
    assert second.episode_end.contact_first[0]
    assert second.episode_end.min_distance_m[0] == np.inf, "there was a contact at once"
    assert first.contact[0]
    assert second.contact[0]


def test_a_contact_after_the_arrival_is_no_failure(city):
    world = make_world(city, horizon=2)
    place(world, [19.0, 50.0, 25.0], [39.0, 50.0, 25.0])
    end = run(world, [EAST[None], EAST[None]])[-1].episode_end
    assert end.reached.tolist() == [True]
    assert end.contact.tolist() == [True]
    assert end.contact_first.tolist() == [False]
    assert end.path_length_m[0] == pytest.approx(20.0), "the way counts until the arrival"


def test_the_books_of_a_straight_flight(city):
    world = make_world(city, horizon=4)
    place(world, [10.0, 10.0, 90.0], [10.0, 61.0, 90.0])
    results = run(world, [NORTH[None]] * 4)
    end = results[-1].episode_end
    assert end.world.tolist() == [0]
    assert end.min_distance_m[0] == pytest.approx(9.0)
    assert end.distance_m[0] == pytest.approx(29.0)
    assert end.path_length_m[0] == pytest.approx(80.0)
    assert end.reward_sum[0] == pytest.approx(sum(r.reward[0] for r in results))


def test_a_lagging_vehicle_falls_short_of_the_kinematic_one(city):
    start, target = [10.0, 10.0, 70.0], [10.0, 95.0, 70.0]
    lagged = make_world(city, dynamics=Dynamics(lag=VelocityLag()), v_max_mps=5.0)
    place(lagged, start, target)
    result = lagged.step(NORTH[None])
    assert lagged.dt_s == pytest.approx(4.0)
    assert 14.0 < result.position_enu_m[0, 1] - 10.0 < 18.5
    assert result.velocity_enu_mps[0, 1] == pytest.approx(5.0, abs=0.02)


def test_substeps_change_the_chords_not_the_way(city):
    ways = []
    for substeps in (1, 8):
        world = make_world(city, dynamics=Dynamics(lag=VelocityLag(), substeps=substeps))
        place(world, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
        world.step(NORTH[None])
        ways.append(world.step(EAST[None]).position_enu_m)
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-9)


def test_a_step_of_another_length_is_asked_more_often(city):
    world = make_world(city, dynamics=Dynamics(lag=VelocityLag()), step_s=0.05, v_max_mps=5.0)
    place(world, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
    north_m = [world.step(NORTH[None]).position_enu_m[0, 1] for _ in range(80)]
    once = make_world(city, dynamics=Dynamics(lag=VelocityLag()), v_max_mps=5.0)
    place(once, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
    assert north_m[-1] == pytest.approx(once.step(NORTH[None]).position_enu_m[0, 1])


def test_climb_and_descent_stay_within_the_limits_of_the_autopilot(city):
    dynamics = Dynamics(lag=VelocityLag(), vertical=VerticalLimits(3.0, 1.5))
    world = make_world(city, 2, dynamics=dynamics, v_max_mps=5.0)
    place(world, [10.0, 10.0, 50.0], [10.0, 95.0, 50.0])
    up_or_down = np.array([UP, [1.0, 1.0, 0.0]])
    for _ in range(3):
        up_mps = world.step(up_or_down).velocity_enu_mps[:, 2]
    np.testing.assert_allclose(up_mps, [3.0, -1.5], atol=1e-3)


def test_ways_near_obstacles_cost_reward_and_end_nothing(city):
    rewards = []
    for keep_weight in (0.0, 0.5):
        reward = Reward(keep_m=3.0, keep_weight=keep_weight)
        world = make_world(city, reward=reward, end_on_contact=True)
        place(world, [38.0, 30.0, 25.0], [38.0, 70.0, 25.0])
        result = world.step(NORTH[None])
        assert not result.contact.any()
        assert not result.terminated.any()
        rewards.append(float(result.reward[0]))
    assert rewards[0] - rewards[1] == pytest.approx(0.8 * 0.5, abs=0.01)
