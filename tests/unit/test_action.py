"""The spherical action: compass examples, poles, borders, round trip."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.policy.action import (
    AIM_SCALING,
    MIN_BEARING_DISTANCE_M,
    PAPER_SCALING,
    TARGET_SCALING,
    ActionScaling,
    action_to_displacement_m,
    action_to_velocity_mps,
    bearing_to_target_rad,
    displacement_to_action,
    polar_to_target_rad,
    spherical_to_displacement,
    to_spherical,
)

EDGE_M = 100.0
actions = arrays(np.float64, (5, 3), elements=st.floats(-1.0, 1.0))
polars = st.floats(0.0, np.pi)
bearings = st.floats(-np.pi, np.pi)


@pytest.mark.parametrize(
    ("rho", "phi_rad", "psi_rad", "displacement"),
    [
        pytest.param(0.2, np.pi / 2, 0.0, [0.2, 0.0, 0.0], id="the paper's example: x axis"),
        pytest.param(0.2, np.pi / 2, np.pi / 2, [0.0, 0.2, 0.0], id="E1: north is y"),
        pytest.param(0.2, np.pi / 2, -np.pi / 2, [0.0, -0.2, 0.0], id="E1: y can decrease"),
        pytest.param(0.2, np.pi / 2, np.pi, [-0.2, 0.0, 0.0], id="west"),
        pytest.param(0.2, 0.0, 1.0, [0.0, 0.0, 0.2], id="E2: phi = 0 goes up, whatever psi"),
        pytest.param(0.2, np.pi, 2.0, [0.0, 0.0, -0.2], id="E2: phi = pi goes DOWN"),
        pytest.param(0.0, 1.0, 2.0, [0.0, 0.0, 0.0], id="rho = 0 stays"),
    ],
)
def test_equation_one_with_its_errata(rho, phi_rad, psi_rad, displacement):
    moved = spherical_to_displacement(np.array(rho), np.array(phi_rad), np.array(psi_rad))
    np.testing.assert_allclose(moved, displacement, atol=1e-15)


@pytest.mark.parametrize(
    ("action", "displacement_m"),
    [
        pytest.param([1.0, -1.0, 0.3], [0.0, 0.0, 20.0], id="up"),
        pytest.param([1.0, 1.0, 0.3], [0.0, 0.0, -20.0], id="down"),
        pytest.param([1.0, 0.0, -1.0], [20.0, 0.0, 0.0], id="psi = 0 is east"),
        pytest.param([1.0, 0.0, 1.0], [20.0, 0.0, 0.0], id="psi = 2 pi is east again"),
        pytest.param([1.0, 0.0, -0.5], [0.0, 20.0, 0.0], id="north"),
        pytest.param([1.0, 0.0, 0.0], [-20.0, 0.0, 0.0], id="zero is west"),
        pytest.param([-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], id="shortest step"),
        pytest.param([0.0, 0.0, -1.0], [10.0, 0.0, 0.0], id="half a step"),
    ],
)
def test_absolute_azimuth_ignores_the_bearing(action, displacement_m):
    for bearing_rad in (0.0, 1.0):
        moved = action_to_displacement_m(np.array(action), PAPER_SCALING, EDGE_M, bearing_rad)
        np.testing.assert_allclose(moved, displacement_m, atol=1e-12)


@given(bearings)
def test_the_zero_action_flies_toward_the_target(bearing_rad):
    moved = action_to_displacement_m(np.zeros(3), TARGET_SCALING, EDGE_M, bearing_rad)
    expected = 10.0 * np.array([np.cos(bearing_rad), np.sin(bearing_rad), 0.0])
    np.testing.assert_allclose(moved, expected, atol=1e-12)


@given(bearings)
def test_the_wrap_of_a_target_azimuth_lies_behind(bearing_rad):
    ends = np.array([[1.0, 0.0, -1.0], [1.0, 0.0, 1.0]])
    moved = action_to_displacement_m(ends, TARGET_SCALING, EDGE_M, bearing_rad)
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-12)
    np.testing.assert_allclose(
        moved[0], -20.0 * np.array([np.cos(bearing_rad), np.sin(bearing_rad), 0.0]), atol=1e-12
    )


@given(bearings, polars)
def test_the_zero_action_flies_at_an_aim_above_or_below(bearing_rad, polar_rad):
    moved = action_to_displacement_m(np.zeros(3), AIM_SCALING, EDGE_M, bearing_rad, polar_rad)
    expected = spherical_to_displacement(np.array(10.0), polar_rad, bearing_rad)
    np.testing.assert_allclose(moved, expected, atol=1e-12)


@given(bearings, polars)
def test_every_direction_stays_within_reach_of_an_aim(bearing_rad, polar_rad):
    for phi, up_m in ((-1.0, 20.0), (1.0, -20.0)):
        action = np.array((1.0, phi, 0.0))
        moved = action_to_displacement_m(action, AIM_SCALING, EDGE_M, bearing_rad, polar_rad)
        np.testing.assert_allclose(moved, (0.0, 0.0, up_m), atol=1e-9)


def test_an_aim_without_its_polar_angle_is_refused():
    with pytest.raises(ValueError, match="polar angle"):
        action_to_displacement_m(np.zeros(3), AIM_SCALING, EDGE_M, 0.0)
    with pytest.raises(ValueError, match="polar angle"):
        displacement_to_action(np.ones(3), AIM_SCALING, EDGE_M, 0.0)


@pytest.mark.parametrize(
    ("target", "polar_rad"),
    [((0, 0, 9), 0.0), ((0, 0, -9), np.pi), ((3, 4, 5), np.pi / 4), ((0, 0, 0), np.pi / 2)],
)
def test_polar_angle_of_a_target(target, polar_rad):
    start = np.array((7.0, 8.0, 9.0))
    assert polar_to_target_rad(start, start + target) == pytest.approx(polar_rad)
    batch = polar_to_target_rad(np.zeros((2, 3)), np.array([target, target], dtype=float))
    np.testing.assert_allclose(batch, polar_rad)


@given(actions, bearings)
def test_batches_equal_single_rows(action, bearing_rad):
    batch = action_to_displacement_m(action, TARGET_SCALING, EDGE_M, np.full(5, bearing_rad))
    for row, moved in zip(action, batch, strict=True):
        single = action_to_displacement_m(row, TARGET_SCALING, EDGE_M, bearing_rad)
        np.testing.assert_array_equal(single, moved)


@given(actions, bearings)
def test_no_step_is_longer_than_rho_max(action, bearing_rad):
    moved = action_to_displacement_m(action, TARGET_SCALING, EDGE_M, bearing_rad)
    assert (np.linalg.norm(moved, axis=-1) <= 20.0 + 1e-9).all()


@given(actions, bearings)
def test_velocity_is_the_displacement_in_rho_max_per_v_max(action, bearing_rad):
    scaling = ActionScaling(rho_min=0.02)
    velocity = action_to_velocity_mps(action, scaling, 8.0, bearing_rad)
    moved = action_to_displacement_m(action, scaling, EDGE_M, bearing_rad)
    np.testing.assert_allclose(velocity, moved * 8.0 / 20.0, atol=1e-12)
    assert (np.linalg.norm(velocity, axis=-1) <= 8.0 + 1e-9).all()


@given(
    arrays(np.float64, (5, 3), elements=st.floats(-11.0, 11.0)),
    bearings,
    polars,
    st.sampled_from([PAPER_SCALING, TARGET_SCALING, AIM_SCALING]),
)
def test_round_trip_keeps_a_displacement_that_one_step_can_make(
    moved, bearing_rad, polar_rad, scaling
):
    action = displacement_to_action(moved, scaling, EDGE_M, bearing_rad, polar_rad)
    assert (np.abs(action) <= 1.0).all()
    again = action_to_displacement_m(action, scaling, EDGE_M, bearing_rad, polar_rad)
    np.testing.assert_allclose(again, moved, atol=1e-9)


def test_a_displacement_too_long_is_shortened_not_turned():
    action = displacement_to_action(np.array([300.0, 400.0, 0.0]), PAPER_SCALING, EDGE_M)
    moved = action_to_displacement_m(action, PAPER_SCALING, EDGE_M)
    np.testing.assert_allclose(moved, [12.0, 16.0, 0.0], atol=1e-9)


def test_actions_outside_count_as_the_nearest_bound():
    outside = to_spherical(np.array([7.0, -7.0, 7.0]), PAPER_SCALING)
    inside = to_spherical(np.array([1.0, -1.0, 1.0]), PAPER_SCALING)
    assert outside == inside


def test_an_action_that_is_not_finite_stays_visible():
    assert np.isnan(action_to_velocity_mps(np.full(3, np.nan), PAPER_SCALING, 5.0)).all()


@pytest.mark.parametrize(
    ("offset_m", "bearing_rad"),
    [
        pytest.param([1.0, 0.0, 5.0], 0.0, id="east"),
        pytest.param([0.0, 1.0, -5.0], np.pi / 2, id="north"),
        pytest.param([-1.0, 0.0, 0.0], np.pi, id="west"),
        pytest.param([-1.0, -1.0, 0.0], -3 * np.pi / 4, id="south-west"),
        pytest.param([0.0, 0.0, 9.0], 0.0, id="straight above: none"),
        pytest.param([-0.0, -0.0, -9.0], 0.0, id="straight below, negative zeros: none"),
        pytest.param([-0.5 * MIN_BEARING_DISTANCE_M, 0.0, 9.0], 0.0, id="just inside the limit"),
        pytest.param([-2 * MIN_BEARING_DISTANCE_M, 0.0, 9.0], np.pi, id="just outside"),
        pytest.param([0.0, 0.0, 0.0], 0.0, id="at the target"),
    ],
)
def test_bearing_to_target(offset_m, bearing_rad):
    # From the origin: elsewhere rounding would move the offset across the limit.
    start, target = np.zeros(3), np.array(offset_m)
    assert bearing_to_target_rad(start, target) == pytest.approx(bearing_rad)
    batch = bearing_to_target_rad(np.zeros((2, 3)), target)
    np.testing.assert_allclose(batch, [bearing_rad, bearing_rad])


@pytest.mark.parametrize(
    "wrong",
    [
        {"rho_min": 0.2},
        {"rho_min": -0.1},
        {"rho_max": float("nan")},
        {"polar_low_rad": 2.0, "polar_high_rad": 1.0},
        {"polar_high_rad": 4.0},
        {"azimuth_low_rad": 7.0},
    ],
)
def test_scalings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=r"need|range|finite"):
        ActionScaling(**wrong)


def test_a_scaling_survives_json():
    encoded = msgspec.json.encode(TARGET_SCALING)
    assert msgspec.json.decode(encoded, type=ActionScaling) == TARGET_SCALING
