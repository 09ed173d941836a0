"""What an actor is measured against in the control loop: a planner and a potential field."""

import numpy as np
import pytest

from companion.policy.action import (
    AIM_SCALING,
    action_to_velocity_mps,
    bearing_to_target_rad,
    polar_to_target_rad,
)
from companion.policy.observation import WAYS
from companion.world.maps import build_map, load_map
from sim.dynamics import VelocityLag
from sim.motion import Dynamics
from sim.targets import TargetPaths
from sim.world import CityWorld
from training.baselines_loop import BASELINES, SLOW_M, PotentialField, fly_the_way
from training.evaluate import fly_straight
from training.loop import evaluate_loop

BLOCK = build_map("block", [100, 100, 100], [[[40, 30], [60, 30], [60, 70], [40, 70]]], [100.0])
every_baseline = pytest.mark.parametrize("policy", BASELINES.values(), ids=BASELINES)


def velocity_mps(policy, start_m, target_m, city=BLOCK):
    """Return what a policy asks for at a place, in still air."""
    world = CityWorld(
        city,
        WAYS,
        AIM_SCALING,
        1,
        np.random.default_rng(0),
        dynamics=Dynamics(lag=VelocityLag()),
    )
    resting = TargetPaths.resting(np.array([target_m], dtype=np.float64))
    observation = world.place(np.array([start_m], dtype=np.float64), resting)
    seen_from_m, aim_m = world.estimate_enu_m, world.aim_enu_m
    return action_to_velocity_mps(
        policy(world, observation),
        world.scaling,
        world.v_max_mps,
        bearing_to_target_rad(seen_from_m, aim_m),
        polar_to_target_rad(seen_from_m, aim_m),
    )[0]


def evaluate(policy, city, **changes):
    options = {"episodes": 16, "seed": 1, "now_s": lambda: 0.0, **changes}
    return evaluate_loop(policy, [city], WAYS, AIM_SCALING, v_max_mps=5.0, **options)


@every_baseline
def test_in_the_open_it_flies_straight_at_full_speed_and_slows_down_at_the_target(policy):
    free = load_map("free")
    far = velocity_mps(policy, (10, 10, 50), (40, 50, 50), free)
    np.testing.assert_allclose(far, (3.0, 4.0, 0.0), atol=1e-6)
    near = velocity_mps(policy, (50, 50, 50), (50, 50 + 0.5 * SLOW_M, 50), free)
    np.testing.assert_allclose(near, (0.0, 2.5, 0.0), atol=1e-6)
    there = velocity_mps(policy, (50, 50, 50), (50, 50, 50), free)
    np.testing.assert_allclose(there, 0.0, atol=1e-6)


def test_repulsion_balances_attraction_where_it_should_and_ends_where_it_should():
    field = PotentialField(influence_m=10.0, balance_m=3.0)

    def ahead_mps(gap_m):
        return velocity_mps(field, (40 - gap_m, 50, 50), (90, 50, 50))[0]

    assert ahead_mps(3.0) == pytest.approx(0.0, abs=1e-6)
    assert ahead_mps(2.0) < -1.0
    assert 0.0 < ahead_mps(4.0) < 5.0
    assert ahead_mps(10.0) == pytest.approx(5.0)


def test_a_target_beside_a_wall_can_be_reached():
    arriving = velocity_mps(PotentialField(), (37.0, 50, 50), (38.0, 50, 50))
    assert arriving[0] > 0.2


def test_in_front_of_a_wall_the_field_waits_and_the_planner_flies_round():
    """The local minimum that potential fields are known for."""
    start_m, target_m = np.array([[20.0, 50.0, 50.0]]), np.array([[80.0, 50.0, 50.0]])

    def begin(world):
        return world.place(start_m, TargetPaths.resting(target_m))

    waited = evaluate(PotentialField(), BLOCK, episodes=1, begin=begin)
    assert waited.timeout_rate == 1.0
    assert evaluate(fly_the_way, BLOCK, episodes=1, begin=begin).completion_rate == 1.0
    assert evaluate(fly_straight, BLOCK, episodes=1, begin=begin).collision_rate == 1.0


def test_the_planner_completes_more_than_flying_straight():
    env1 = load_map("env1")
    straight, planner = (evaluate(policy, env1) for policy in (fly_straight, fly_the_way))
    assert straight.completion_rate < 0.75
    assert planner.completion_rate > 0.95
