import math

import numpy as np
import pytest

from sim.reward import (
    Reward,
    arrival_reward,
    check_beta,
    guidance_reward,
    obstacle_penalty,
    step_reward,
)


@pytest.mark.parametrize(
    ("distance", "crash_depth", "beta", "reward"),
    [
        pytest.param(0.0, 0.0, 0.8, 0.2, id="on the target"),
        pytest.param(0.5, 0.0, 0.8, 0.2 * math.exp(-1.25), id="half an edge away"),
        pytest.param(
            0.1,
            0.02,
            0.8,
            0.2 * math.exp(-0.05) + 0.8 * (math.exp(-2.0) - 1.0),
            id="two metres deep",
        ),
        pytest.param(0.1, 0.02, 0.4, 0.6 * math.exp(-0.05) - 0.4 * (1.0 - math.exp(-2.0))),
        pytest.param(0.3, 0.5, 0.0, math.exp(-0.45), id="crashes cost nothing at beta 0"),
    ],
)
def test_equation_2_by_hand(distance, crash_depth, beta, reward):
    assert step_reward(np.array(distance), np.array(crash_depth), beta=beta) == pytest.approx(
        reward, rel=1e-12
    )


def test_bounds_and_monotony():
    grid = np.linspace(0.0, math.sqrt(3.0), 200)
    guidance, penalty = guidance_reward(grid), obstacle_penalty(grid)
    assert guidance[0] == 1.0
    assert penalty[0] == 0.0
    assert np.all(np.diff(guidance) < 0.0)
    assert np.all(np.diff(penalty) <= 0.0)
    assert np.all(penalty >= -1.0)


def test_a_graze_costs_in_proportion():
    assert obstacle_penalty(np.array(1e-9)) == pytest.approx(-1e-7, rel=1e-6)


def test_any_shape():
    distance, depth = np.full((4, 5), 0.2), np.full((4, 5), 0.1)
    assert step_reward(distance, depth, beta=0.8).shape == (4, 5)


@pytest.mark.parametrize("beta", [0.0, 0.4, 0.8, 0.999])
def test_sensible_beta_is_kept(beta):
    assert check_beta(beta) == beta


def test_the_literal_beta_of_the_paper_is_refused_with_the_reason():
    with pytest.raises(ValueError, match=r"beta = 4 gives .* weight 1 - beta = -3.*beta = 0\.8"):
        check_beta(4.0)


@pytest.mark.parametrize("beta", [1.0, -0.1, math.nan, math.inf])
def test_other_nonsense_is_refused(beta):
    with pytest.raises(ValueError, match="beta"):
        check_beta(beta)


def test_by_default_the_reward_is_the_papers():
    distance, depth = np.array([0.0, 0.05, 0.9]), np.array([0.0, 0.01, 0.0])
    np.testing.assert_array_equal(
        Reward().of(distance, depth, None), step_reward(distance, depth, beta=0.8)
    )


def test_the_arrival_term_is_steep_where_the_papers_is_flat():
    hovering, arrived, nothing = np.array(0.052), np.array(0.01), np.array(0.0)
    gained = [
        float(reward.of(arrived, nothing, None) / reward.of(hovering, nothing, None))
        for reward in (Reward(), Reward(arrival_weight=1.0))
    ]
    assert gained[0] < 1.02
    assert gained[1] > 1.5
    assert float(arrival_reward(np.array(0.0))) == 1.0


@pytest.mark.parametrize("options", [{"beta": 4.0}, {"arrival_weight": -1.0}, {"keep_m": -1.0}])
def test_rewards_that_make_no_sense_are_refused(options):
    with pytest.raises(ValueError, match=r"beta|negative"):
        Reward(**options)
