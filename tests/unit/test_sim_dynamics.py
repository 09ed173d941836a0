import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sim.dynamics import (
    Disturbance,
    VelocityLag,
    VerticalLimits,
    clip_to_box,
    follow_velocity,
    stop_at_walls,
)
from sim.motion import Dynamics

velocities_mps = arrays(np.float64, (4, 3), elements=st.floats(-15.0, 15.0))
durations_s = st.floats(0.0, 5.0)
LAG = VelocityLag(time_constant_s=0.5, acceleration_max_mps2=4.0)


@given(velocities_mps, velocities_mps, durations_s, durations_s)
def test_cutting_the_time_changes_nothing(velocity, setpoint, first_s, second_s):
    whole_velocity, whole_way = follow_velocity(velocity, setpoint, LAG, dt_s=first_s + second_s)
    half_velocity, first_way = follow_velocity(velocity, setpoint, LAG, dt_s=first_s)
    end_velocity, second_way = follow_velocity(half_velocity, setpoint, LAG, dt_s=second_s)
    np.testing.assert_allclose(end_velocity, whole_velocity, atol=1e-9)
    np.testing.assert_allclose(first_way + second_way, whole_way, atol=1e-9)


@given(velocities_mps, velocities_mps)
def test_the_acceleration_limit_holds(velocity, setpoint):
    after, _ = follow_velocity(velocity, setpoint, LAG, dt_s=0.01)
    gained_mps = np.linalg.norm(after - velocity, axis=-1)
    assert np.all(gained_mps <= LAG.acceleration_max_mps2 * 0.01 + 1e-12)


def test_first_order_below_the_limit():
    after, way = follow_velocity(np.zeros(3), np.array([1.0, 0.0, 0.0]), LAG, dt_s=0.5)
    np.testing.assert_allclose(after, [1.0 - np.exp(-1.0), 0.0, 0.0])
    np.testing.assert_allclose(way, [0.5 - 0.5 * (1.0 - np.exp(-1.0)), 0.0, 0.0])


def test_constant_acceleration_above_the_limit():
    after, way = follow_velocity(np.zeros(3), np.array([0.0, 0.0, 10.0]), LAG, dt_s=1.0)
    np.testing.assert_allclose(after, [0.0, 0.0, 4.0])
    np.testing.assert_allclose(way, [0.0, 0.0, 2.0])


@given(velocities_mps, velocities_mps, durations_s)
def test_a_batch_is_its_rows(velocity, setpoint, dt_s):
    batch_velocity, batch_way = follow_velocity(velocity, setpoint, LAG, dt_s=dt_s)
    for row in range(len(velocity)):
        one_velocity, one_way = follow_velocity(velocity[row], setpoint[row], LAG, dt_s=dt_s)
        np.testing.assert_allclose(one_velocity, batch_velocity[row], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(one_way, batch_way[row], rtol=1e-12, atol=1e-12)


def test_each_vehicle_may_have_a_time_constant_of_its_own():
    slow_s = np.array([0.3, 0.5, 1.0])
    setpoint = np.tile([1.0, 0.0, 0.0], (3, 1))
    after, _ = follow_velocity(np.zeros((3, 3)), setpoint, LAG, dt_s=0.5, time_constant_s=slow_s)
    np.testing.assert_allclose(after[:, 0], 1.0 - np.exp(-0.5 / slow_s))


@given(velocities_mps)
def test_vertical_limits_shorten_and_do_not_turn(velocity):
    within = VerticalLimits(climb_max_mps=3.0, descent_max_mps=1.5).within(velocity)
    assert np.all(within[:, 2] <= 3.0 + 1e-9)
    assert np.all(within[:, 2] >= -1.5 - 1e-9)
    np.testing.assert_allclose(np.cross(within, velocity), 0.0, atol=1e-9)
    easy = (velocity[:, 2] <= 3.0) & (velocity[:, 2] >= -1.5)
    np.testing.assert_array_equal(within[easy], velocity[easy])


def test_a_disturbance_keeps_its_spread_and_forgets():
    rng = np.random.default_rng(3)
    wind = Disturbance(std=1.5, correlation_s=4.0)
    first = wind.sample(rng, (40_000, 3))
    value = first
    for _ in range(8):
        value = wind.advance(value, dt_s=0.5, rng=rng)
    assert np.std(value) == pytest.approx(1.5, rel=0.02)
    correlation = np.mean(first * value) / np.mean(first * first)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.02)


def test_no_disturbance_is_none():
    still = Disturbance(std=0.0, correlation_s=1.0)
    rng = np.random.default_rng(0)
    assert not still.advance(still.sample(rng, (5, 3)), dt_s=0.1, rng=rng).any()


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        pytest.param(VelocityLag, {"time_constant_s": 0.0}, id="instant"),
        pytest.param(VelocityLag, {"time_constant_s": float("nan")}, id="nan"),
        pytest.param(VelocityLag, {"acceleration_max_mps2": -1.0}, id="deceleration"),
        pytest.param(VerticalLimits, {"climb_max_mps": 0.0}, id="no climb"),
        pytest.param(Dynamics, {"wind": Disturbance(1.0, 1.0)}, id="wind without lag"),
        pytest.param(Dynamics, {"substeps": 2}, id="substeps without lag"),
        pytest.param(
            Dynamics, {"lag": LAG, "time_constant_s": (1.0, 0.3)}, id="descending time constants"
        ),
        pytest.param(Dynamics, {"lag": LAG, "start_speed_mps": -1.0}, id="negative speed"),
        pytest.param(Disturbance, {"std": -0.1, "correlation_s": 1.0}, id="negative std"),
        pytest.param(Disturbance, {"std": 0.1, "correlation_s": 0.0}, id="no correlation"),
    ],
)
def test_nonsense_is_refused(kind, options):
    with pytest.raises(ValueError, match=r"must|need"):
        kind(**options)


@pytest.mark.parametrize(
    ("position", "clipped"),
    [
        pytest.param([-1.0, 50.0, 120.0], [0.0, 50.0, 100.0], id="slides along walls"),
        pytest.param([0.0, 100.0, 30.0], [0.0, 100.0, 30.0], id="the border belongs to the box"),
    ],
)
def test_clip_to_box(position, clipped):
    np.testing.assert_array_equal(clip_to_box(np.array(position), np.full(3, 100.0)), clipped)


def test_velocity_stops_at_walls_only_outward():
    velocity = stop_at_walls(
        np.array([[-1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]),
        np.array([[0.0, 100.0, 50.0], [0.0, 99.0, 100.0]]),
        np.full(3, 100.0),
    )
    np.testing.assert_array_equal(velocity, [[0.0, 0.0, 3.0], [1.0, 2.0, 0.0]])
