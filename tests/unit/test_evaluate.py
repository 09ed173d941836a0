"""Counting: known policies on maps made for them, intervals, and cases that are held out."""

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.actor import Actor
from companion.policy.observation import PAPER, RELATIVE
from companion.world.maps import build_map, load_map
from sim.world import CityWorld
from training.evaluate import evaluate_policy, fly_straight, wilson_interval
from training.seeds import Purpose, generator

FREE = load_map("free")
# A wall from border to border and from the ground to the ceiling, 20 m thick.
WALLED = build_map("walled", [100, 100, 100], [[[40, 0], [60, 0], [60, 100], [40, 100]]], [100.0])


def evaluate(policy, city=FREE, layout=RELATIVE, scaling=TARGET_SCALING, **changes):
    options = {"episodes": 300, "seed": 1, "now_s": lambda: 0.0, **changes}
    return evaluate_policy(policy, (city,), layout, scaling, **options)


def stay(world, observation):
    return np.full((world.num_worlds, 3), [-1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("layout", "scaling"), [(PAPER, PAPER_SCALING), (RELATIVE, TARGET_SCALING)]
)
def test_flying_straight_in_free_space_completes_every_case(layout, scaling):
    result = evaluate(fly_straight, layout=layout, scaling=scaling)
    assert result.completion_rate == result.completion_5m == result.completion_1m == 1.0
    assert (result.collision_rate, result.timeout_rate) == (0.0, 0.0)
    assert result.spl == pytest.approx(1.0)
    assert result.path_stretch <= 1.0 + 1e-9


def test_staying_times_out_unless_it_began_at_the_target():
    result = evaluate(stay)
    assert result.collision_rate == 0.0
    assert result.timeout_rate == pytest.approx(1.0 - result.completion_rate)
    assert result.completion_rate < 0.02


def test_a_wall_stops_half_of_the_straight_flights():
    result = evaluate(fly_straight, city=WALLED, episodes=2000, measure_clearance=True)
    assert result.completion_rate == pytest.approx(0.5, abs=0.05)
    assert result.collision_rate == pytest.approx(1.0 - result.completion_rate)
    assert result.timeout_rate == 0.0
    assert result.min_clearance_m["p1"] < 0.0 < result.min_clearance_m["p50"] + 20.0


def test_rates_add_up():
    result = evaluate(fly_straight, city=load_map("env1"))
    total = result.completion_rate + result.collision_rate + result.timeout_rate
    assert total == pytest.approx(1.0)
    assert result.completion_1m <= result.completion_2m <= result.completion_5m


def test_cases_spread_over_several_maps_are_all_counted():
    result = evaluate_policy(
        fly_straight,
        (FREE, WALLED),
        RELATIVE,
        TARGET_SCALING,
        episodes=2000,
        seed=1,
        measure_clearance=True,
        now_s=lambda: 0.0,
    )
    assert result.completion_rate == pytest.approx(0.75, abs=0.04)


def test_clearance_says_nothing_on_a_map_without_obstacles():
    assert evaluate(fly_straight, measure_clearance=True).min_clearance_m is None


def test_moving_targets_are_harder_to_catch_without_foresight():
    moving = evaluate(fly_straight, moving=True)
    assert moving.completion_rate <= 1.0
    assert moving.path_stretch > evaluate(fly_straight).path_stretch


def test_the_bundled_actor_of_the_free_map_completes_every_case():
    actor = Actor.load("paper-free")
    layout, scaling = actor.contract.layout, actor.contract.action
    result = evaluate(lambda _, seen: actor.act(seen), layout=layout, scaling=scaling)
    assert result.completion_rate == 1.0


def test_the_same_seed_gives_the_same_cases():
    assert evaluate(fly_straight, city=WALLED) == evaluate(fly_straight, city=WALLED)
    assert evaluate(fly_straight, city=WALLED) != evaluate(fly_straight, city=WALLED, seed=2)


def test_no_purpose_shares_a_stream_with_another():
    draws = [generator(seed, purpose).random(4).tolist() for purpose in Purpose for seed in (0, 1)]
    assert len({tuple(draw) for draw in draws}) == len(draws)


def test_test_cases_differ_from_training_and_validation():
    starts = [
        CityWorld(FREE, RELATIVE, TARGET_SCALING, 50, generator(0, purpose)).position_enu_m
        for purpose in (Purpose.WORLD, Purpose.VALIDATION, Purpose.TEST)
    ]
    for one in range(3):
        for other in range(one):
            assert not np.isin(starts[one], starts[other]).any()


@pytest.mark.parametrize(
    ("rate", "count", "low", "high"),
    [
        # Wilson's interval as tabulated, e.g. by R's binom.confint(method = "wilson").
        (0.5, 10, 0.2366, 0.7634),
        (0.84, 1000, 0.8160, 0.8614),
        (1.0, 1000, 0.9962, 1.0),
        (0.0, 1000, 0.0, 0.0038),
    ],
)
def test_wilson_interval(rate, count, low, high):
    assert wilson_interval(rate, count) == pytest.approx((low, high), abs=1e-4)
