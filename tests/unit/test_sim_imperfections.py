"""Imperfect vehicles and links: what each option does, and that none of it is there by default."""

import numpy as np
import pytest

from companion.policy.action import TARGET_SCALING
from companion.policy.observation import RELATIVE, WAYS
from companion.world.maps import build_map
from sim.dynamics import Disturbance, VelocityLag
from sim.imperfections import POOR_RADIO, Imperfections
from sim.motion import Dynamics
from sim.world import CityWorld

OPEN = build_map("open", (200, 200, 100), [], [])
STEP_S = 0.05
WORLDS = 40


def make_world(imperfections=None, *, layout=RELATIVE, seed=0, moving=False, **dynamics):
    return CityWorld(
        OPEN,
        layout,
        TARGET_SCALING,
        WORLDS,
        np.random.default_rng(seed),
        horizon=10_000,
        step_s=STEP_S,
        target_motion="moving" if moving else "static",
        dynamics=Dynamics(lag=VelocityLag(0.5), **dynamics),
        imperfections=imperfections,
    )


def follow(world, velocity, steps):
    setpoint = np.broadcast_to(np.array(velocity, dtype=np.float64), (WORLDS, 3))
    return [world.follow(setpoint) for _ in range(steps)]


def test_without_imperfections_nothing_is_drawn_and_all_is_known_at_once():
    plain, listed = make_world(), make_world(Imperfections())
    start = plain.position_enu_m
    np.testing.assert_array_equal(start, listed.position_enu_m)
    (result,) = follow(plain, (1.0, 0.0, 0.0), 1)
    np.testing.assert_array_equal(plain.estimate_enu_m, result.position_enu_m)
    np.testing.assert_array_equal(plain.velocity_enu_mps, result.velocity_enu_mps)


def test_positions_are_as_old_as_told():
    world = make_world(Imperfections(age_s=(0.15, 0.15)))
    start = world.position_enu_m
    np.testing.assert_array_equal(world.estimate_enu_m, start)
    results = follow(world, (3.0, 0.0, 0.0), 8)
    np.testing.assert_array_equal(world.estimate_enu_m, results[4].position_enu_m)
    np.testing.assert_array_equal(world.velocity_enu_mps, results[4].velocity_enu_mps)


def test_between_two_steps_what_is_known_is_read_off_a_straight_line():
    """Training steps are longer than a position is old."""
    world = make_world(Imperfections(age_s=(0.02, 0.04)))
    results = follow(world, (3.0, 0.0, 0.0), 8)
    newest, before = results[-1], results[-2]
    way_m = newest.position_enu_m - before.position_enu_m
    behind = (newest.position_enu_m - world.estimate_enu_m)[:, 0] / way_m[:, 0]
    assert ((behind > 0.4) & (behind < 0.8)).all()
    assert np.ptp(behind) > 0.2, "each its own"
    np.testing.assert_allclose(
        world.estimate_enu_m, newest.position_enu_m - behind[:, None] * way_m, atol=1e-9
    )


def test_a_velocity_is_reached_as_slowly_and_as_nearly_as_told():
    brisk, limits = make_world(), (1.0, 1.5)
    lazy = make_world(Imperfections(acceleration_max_mps2=limits, shortfall=(0.1, 0.2)))
    free = (brisk.position_enu_m < (120.0, 200.0, 80.0)).all(axis=1)  # of the sides of the map
    fast = follow(brisk, (4.0, 0.0, 1.0), 20)[-1].velocity_enu_mps[free]
    slow = follow(lazy, (4.0, 0.0, 1.0), 20)[-1].velocity_enu_mps[free]
    gained = np.linalg.norm(slow, axis=1)
    assert (gained < np.linalg.norm(fast, axis=1)).all()
    assert (limits[0] - 0.01 < gained).all()
    assert (gained < limits[1] + 0.01).all()
    assert np.ptp(gained) > 0.1, "each its own"
    settled = follow(lazy, (4.0, 0.0, 1.0), 200)[-1].velocity_enu_mps[free]
    assert (settled[:, 0] < 0.9 * 4.0 + 1e-3).all()
    assert (settled[:, 0] > 0.8 * 4.0 - 1e-3).all()
    # Climbs fall short of nothing.
    np.testing.assert_allclose(settled[:, 2], 1.0, atol=1e-3)


def test_lost_setpoints_are_replaced_by_the_ones_before():
    world = make_world(Imperfections(setpoint_loss=0.5))
    follow(world, (2.0, 0.0, 0.0), 40)
    before = world.velocity_enu_mps
    (result,) = follow(world, (-2.0, 0.0, 0.0), 1)
    turned = result.velocity_enu_mps[:, 0] < before[:, 0] - 0.05
    assert 0.25 < turned.mean() < 0.75


def test_targets_are_seen_with_noise_and_fall_silent():
    world = make_world(
        Imperfections(target_noise=Disturbance(0.5, 2.0), target_silence_s=(2.0, 1.0)), moving=True
    )
    errors, still = [], []
    known = world.aim_enu_m
    for _ in range(200):
        (result,) = follow(world, (0.0, 0.0, 0.0), 1)
        still.append((world.aim_enu_m == known).all(axis=1))
        known = world.aim_enu_m
        errors.append(known - result.target_enu_m)
    assert 0.2 < np.mean(still) < 0.5, "a second of three"
    heard = np.array(errors)[~np.array(still)]
    assert np.std(heard) == pytest.approx(0.5, rel=0.2)


def test_they_are_taken_restarted_and_restored_with_their_worlds():
    options = {"layout": WAYS, "moving": True, "position_noise": Disturbance(0.3, 2.0)}
    world = make_world(POOR_RADIO, **options)
    follow(world, (1.0, 2.0, 0.5), 10)
    state = world.state_dict()
    other = make_world(POOR_RADIO, seed=5, **options)
    observation = other.load_state_dict(state)
    results = [follow(each, (1.0, 2.0, 0.5), 20)[-1].observation for each in (world, other)]
    np.testing.assert_array_equal(*results)
    assert observation.shape == results[0].shape
    rows = np.array([3, 7])
    some = other.take(rows)
    np.testing.assert_array_equal(some.estimate_enu_m, other.estimate_enu_m[rows])
    some.follow(np.zeros((2, 3)))


def test_the_cases_are_the_same_however_imperfect_the_vehicles():
    worlds = [make_world(kind, seed=3, moving=True) for kind in (None, POOR_RADIO)]
    for world in worlds:
        world.reset()
    np.testing.assert_array_equal(*(world.position_enu_m for world in worlds))
    np.testing.assert_array_equal(*(world.target_enu_m for world in worlds))


@pytest.mark.parametrize(
    "options",
    [
        {"acceleration_max_mps2": (0.0, 1.0)},
        {"shortfall": (0.2, 0.1)},
        {"age_s": (-0.1, 0.0)},
        {"age_s": (0.2, 0.1)},
        {"setpoint_loss": 1.0},
        {"target_silence_s": (0.0, 1.0)},
    ],
)
def test_what_makes_no_sense_is_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Imperfections(**options)


def test_the_kinematic_point_is_perfect():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="imperfections need a lag"):
        CityWorld(OPEN, RELATIVE, TARGET_SCALING, 2, rng, imperfections=Imperfections())
