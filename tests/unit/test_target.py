"""Target tracks: tiers at their borders, repeats, jumps, coasting."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.target import (
    COAST_S,
    FRESH_S,
    JUMP_REPORTS,
    LOST_S,
    MAX_SPEED_MPS,
    TargetTier,
    TargetTrack,
)

HERE = np.array([50.0, 50.0, 20.0])
EAST_2_MPS = np.array([2.0, 0.0, 0.0])


def heard(position=HERE, velocity=EAST_2_MPS, time_s=10.0):
    track = TargetTrack()
    track.report(np.array(position), velocity, time_s=time_s)
    return track


def test_nothing_heard_is_no_target():
    estimate = TargetTrack().estimate(5.0)
    assert estimate.tier is TargetTier.NONE
    assert estimate.position_enu_m is None


def test_static_target_never_ages():
    estimate = TargetTrack(HERE).estimate(1e6)
    assert estimate.tier is TargetTier.FRESH
    assert estimate.age_s == 0.0
    np.testing.assert_array_equal(estimate.position_enu_m, HERE)


@pytest.mark.parametrize(
    ("age_s", "tier"),
    [
        (FRESH_S - 0.01, TargetTier.FRESH),
        (FRESH_S + 0.01, TargetTier.COAST),
        (COAST_S - 0.01, TargetTier.COAST),
        (COAST_S + 0.01, TargetTier.HOLD),
        (LOST_S - 0.01, TargetTier.HOLD),
        (LOST_S + 0.01, TargetTier.LOST),
    ],
)
def test_tiers_on_both_sides_of_their_borders(age_s, tier):
    assert heard().estimate(10.0 + age_s).tier is tier


def test_coasts_with_the_last_velocity_then_stops():
    track = heard()
    np.testing.assert_allclose(track.estimate(11.0).position_enu_m, HERE + EAST_2_MPS)
    stopped = track.estimate(10.0 + COAST_S + 1.0)
    np.testing.assert_allclose(stopped.position_enu_m, HERE + EAST_2_MPS * COAST_S)
    np.testing.assert_array_equal(stopped.velocity_enu_mps, np.zeros(3))


def test_a_repeat_does_not_make_a_track_younger():
    track = TargetTrack()
    for k in range(20):
        track.report(HERE, EAST_2_MPS, time_s=10.0 + 0.25 * k, source_time_s=7.0)
    assert track.estimate(10.0 + 0.25 * 19).tier is TargetTier.LOST


def test_a_target_that_stands_still_is_told_from_a_repeat_by_its_own_clock():
    track = TargetTrack()
    for k in range(20):
        track.report(HERE, np.zeros(3), time_s=10.0 + 0.25 * k, source_time_s=7.0 + 0.25 * k)
    assert track.estimate(10.0 + 0.25 * 19).tier is TargetTier.FRESH


def test_slow_sender_stays_fresh_for_one_and_a_half_of_its_periods():
    track = TargetTrack()
    for k in range(40):
        track.report(HERE + k * np.array([0.9, 0, 0]), None, time_s=10.0 + 0.9 * k)
    last_s = 10.0 + 0.9 * 39
    assert track.estimate(last_s + 1.2).tier is TargetTier.FRESH
    assert track.estimate(last_s + COAST_S + 0.1).tier is TargetTier.HOLD


def test_velocity_comes_from_positions_where_the_source_gives_none():
    track = TargetTrack()
    track.report(HERE, None, time_s=10.0)
    track.report(HERE + np.array([0.0, 1.0, 0.0]), None, time_s=10.5)
    np.testing.assert_allclose(track.estimate(10.5).velocity_enu_mps, [0.0, 2.0, 0.0])


def test_a_single_jump_is_ignored_and_an_agreed_one_restarts_the_track():
    track = heard(velocity=np.zeros(3))
    there = HERE + np.array([60.0, 0.0, 0.0])
    track.report(there, np.zeros(3), time_s=10.2)
    np.testing.assert_allclose(track.estimate(10.2).position_enu_m, HERE)
    for k in range(1, JUMP_REPORTS):
        track.report(there + np.array([0.1 * k, 0, 0]), np.zeros(3), time_s=10.2 + 0.2 * k)
    assert track.num_rejected == JUMP_REPORTS
    np.testing.assert_allclose(track.estimate(10.6).position_enu_m[0], there[0], atol=0.5)


def test_jumps_that_do_not_agree_never_win():
    track = heard(velocity=np.zeros(3))
    for k in range(6):
        far = HERE + np.array([60.0 if k % 2 else -60.0, 0.0, 0.0])
        track.report(far, np.zeros(3), time_s=10.1 + 0.1 * k)
    np.testing.assert_allclose(track.estimate(10.6).position_enu_m, HERE)


@given(
    values=st.lists(st.sampled_from([0.0, np.nan, np.inf, -np.inf]), min_size=3, max_size=3).filter(
        lambda v: not np.isfinite(v).all()
    )
)
def test_not_a_number_is_never_a_position(values):
    track = heard()
    track.report(np.array(values), None, time_s=10.1)
    assert np.isfinite(track.estimate(10.1).position_enu_m).all()


def test_an_impossible_velocity_is_capped():
    track = heard(velocity=np.array([300.0, 400.0, 0.0]))
    assert np.linalg.norm(track.estimate(10.0).velocity_enu_mps) == pytest.approx(MAX_SPEED_MPS)


def test_forget_drops_a_reported_target_and_keeps_a_static_one():
    reported, static = heard(), TargetTrack(HERE)
    reported.forget()
    static.forget()
    assert reported.estimate(10.0).tier is TargetTier.NONE
    assert static.estimate(10.0).tier is TargetTier.FRESH
