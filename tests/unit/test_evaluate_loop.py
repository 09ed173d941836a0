"""Counting in the control loop: known policies, with and without the shield behind them."""

import numpy as np
import pytest

from companion.guidance.drift import DriftObserver
from companion.guidance.guidance import propose
from companion.guidance.guide import Guide
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.policy.action import TARGET_SCALING
from companion.policy.actor import Actor
from companion.policy.observation import RELATIVE
from companion.world.maps import build_map, load_map
from sim.dynamics import VelocityLag
from sim.motion import Dynamics
from sim.world import CityWorld
from training.evaluate import fly_straight
from training.guard import Guard
from training.loop import Conditions, evaluate_loop

FREE = load_map("free")
# A wall from border to border and from the ground to the ceiling, 20 m thick.
WALLED = build_map("walled", [100, 100, 100], [[[40, 0], [60, 0], [60, 100], [40, 100]]], [100.0])


def evaluate(policy=fly_straight, maps=(FREE,), **changes):
    options = {"v_max_mps": 5.0, "episodes": 40, "seed": 1, "now_s": lambda: 0.0, **changes}
    return evaluate_loop(policy, maps, RELATIVE, TARGET_SCALING, **options)


def stay(world, observation):
    return np.full((world.num_worlds, 3), [-1.0, 0.0, 0.0])


def test_flying_straight_in_free_space_completes_every_case():
    result = evaluate()
    assert result.completion_rate == 1.0
    assert result.completion_2m > 0.5  # it slows down in front of the target
    assert (result.collision_rate, result.timeout_rate) == (0.0, 0.0)
    assert 0.9 < result.path_stretch < 1.1  # the last 5 m are not flown, gusts are
    assert result.shield_interventions == 0


def test_staying_times_out():
    result = evaluate(stay)
    assert result.timeout_rate == pytest.approx(1.0 - result.completion_rate)
    assert result.completion_rate < 0.1


def test_the_shield_turns_collisions_into_time_outs():
    cases = {"maps": (WALLED,), "episodes": 16, "v_max_mps": 10.0, "measure_clearance": True}
    alone, shielded = evaluate(**cases), evaluate(**cases, shield=True)
    assert 0.2 < alone.collision_rate < 0.8
    assert alone.min_clearance_m["p1"] < 0.0
    assert alone.shield_interventions == 0
    assert shielded.collision_rate == 0.0
    assert shielded.timeout_rate == pytest.approx(alone.collision_rate)
    assert shielded.completion_rate == pytest.approx(alone.completion_rate)
    assert shielded.min_clearance_m["p1"] > 0.5
    assert shielded.shield_interventions > 0


def test_cases_over_several_maps_are_counted_once_each():
    result = evaluate(maps=(FREE, WALLED), episodes=80)
    assert result.completion_rate == pytest.approx(0.75, abs=0.15)
    total = result.completion_rate + result.collision_rate + result.timeout_rate
    assert total == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_flights():
    env1 = load_map("env1")
    assert evaluate(maps=(env1,)) == evaluate(maps=(env1,))
    assert evaluate(maps=(env1,)) != evaluate(maps=(env1,), seed=2)


def test_a_larger_map_has_more_time():
    wide = build_map("wide", [300, 300, 100], [[[1, 1], [2, 1], [2, 2]]], [1.0])
    assert evaluate(maps=(wide,), episodes=20).completion_rate > 0.9


def test_the_vehicle_is_that_of_the_conditions():
    still = Conditions(dynamics=Dynamics(lag=VelocityLag()))
    assert evaluate(conditions=still, seed=3) != evaluate(seed=3)


def test_behind_the_shield_decisions_are_those_of_flight():
    """The batched path asks actor and shield exactly what ``companion.control`` asks them."""
    actor, city = Actor.load("flight"), load_map("env1")
    scaling, layout = actor.contract.action, actor.contract.layout
    world = CityWorld(
        city,
        layout,
        scaling,
        8,
        np.random.default_rng(4),
        step_s=0.05,
        dynamics=Conditions().dynamics,
    )
    guard, shield = Guard(world, 5.0), Shield(city, ShieldLimits(v_max_mps=5.0))
    observation, before = world.reset(), np.zeros((8, 3))
    observers = [DriftObserver() for _ in range(8)]
    guides = [Guide(city, layout) for _ in range(8)]
    for row, guide in enumerate(guides):
        for _ in range(40):
            guide.work(world.estimate_enu_m[row], world.target_enu_m[row])
    for _ in range(40):
        sent = guard.check(world, actor.act(observation))
        for row in range(8):
            position, velocity = world.estimate_enu_m[row], world.velocity_enu_mps[row]
            proposal = propose(
                actor,
                city,
                position_enu_m=position,
                velocity_enu_mps=velocity,
                target_enu_m=world.target_enu_m[row],
                v_max_mps=5.0,
                ahead=guides[row].ahead(position, world.target_enu_m[row]),
            )
            decision = shield.check(
                proposal.velocity_enu_mps,
                position_enu_m=position,
                velocity_now_enu_mps=velocity,
                drift=observers[row].update(velocity, before[row], shield.braking, dt_s=0.05),
            )
            np.testing.assert_allclose(sent[row], decision.velocity_enu_mps, atol=1e-4)
        observation, before = world.follow(sent).observation, sent
