"""The model of the vehicle, the hazards and the candidates that the shield is made of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.braking import PACES, Braking
from companion.guidance.candidates import MAX_WALLS, fan, nearest_first, within_walls
from companion.guidance.hazards import Hazards, Kind, crossing
from companion.world.maps import build_map
from sim.dynamics import VelocityLag, follow_velocity

L = np.array([[20, 20], [60, 20], [60, 35], [35, 35], [35, 70], [20, 70]], float)
SPLINTER = np.array([[70, 70], [95, 74], [70, 76]], float)
CITY = build_map("city", (100, 100, 80), [L, SPLINTER], [30.0, 55.0])
HAZARDS = Hazards.of_map(CITY, margin_m=2.0, min_height_m=1.5)
IS_OBSTACLE = HAZARDS.kind == Kind.OBSTACLE

lags = st.floats(0.2, 1.5)
brakes = st.floats(0.8, 5.0)
speeds = st.floats(0.0, 12.0)
unit = st.floats(-1.0, 1.0)
velocities = st.tuples(unit, unit, unit).map(lambda v: 6.0 * np.array(v))


# -- braking ------------------------------------------------------------------------------------


@given(lags, brakes, speeds)
def test_the_stopping_distance_is_that_of_the_simulated_vehicle(lag_s, brake_mps2, speed_mps):
    _, moved = follow_velocity(
        np.array([speed_mps, 0.0, 0.0]), np.zeros(3), VelocityLag(lag_s, brake_mps2), dt_s=1e3
    )
    way_m = Braking(lag_s, brake_mps2).stopping_distance_m(np.array(speed_mps))
    assert way_m == pytest.approx(moved[0], abs=1e-9)


@given(lags, brakes, speeds, st.floats(0.0, 0.5))
def test_the_approach_speed_is_the_inverse(lag_s, brake_mps2, speed_mps, reaction_s):
    braking = Braking(lag_s, brake_mps2)
    way_m = speed_mps * reaction_s + braking.stopping_distance_m(np.array(speed_mps))
    assert braking.approach_speed_mps(way_m, reaction_s) == pytest.approx(speed_mps, abs=1e-6)


def test_there_is_no_approach_where_no_way_is_left():
    speed = Braking(0.5, 1.6).approach_speed_mps(np.array([0.0, -1.0, -np.inf]), 0.1)
    assert speed.tolist() == [0.0, 0.0, 0.0]


@given(lags, brakes, velocities, velocities)
def test_paths_run_from_the_model_itself_to_an_instant_response(lag_s, brake_mps2, now, command):
    braking, lag = Braking(lag_s, brake_mps2), VelocityLag(lag_s, brake_mps2)
    begin, rest = braking.stopping_paths_m(now, command[None], follow_s=0.15)
    velocity, moved = follow_velocity(now, command, lag, dt_s=0.15)
    _, stopped = follow_velocity(velocity, np.zeros(3), lag, dt_s=1e3)
    slow, quick = PACES.index(0.0), PACES.index(1.0)
    assert begin[0, slow] == pytest.approx(moved, abs=1e-9)
    assert rest[0, slow] == pytest.approx(moved + stopped, abs=1e-6)
    assert begin[0, quick] == pytest.approx(0.15 * command, abs=1e-9)


# -- hazards ------------------------------------------------------------------------------------

places = st.tuples(st.floats(-5, 105), st.floats(-5, 105), st.floats(0.1, 85)).map(np.array)


@settings(max_examples=500)
@given(places)
def test_outside_the_distance_to_planes_is_never_too_large_and_bounded(place):
    exact_m = float(CITY.obstacles.signed_distance_m(place))
    if exact_m <= 0.0:
        return  # inside, the pieces of one concave obstacle know nothing of each other
    planes_m = float(HAZARDS.plane_distance_m(place).max(axis=1)[IS_OBSTACLE].min())
    assert planes_m <= exact_m + 1e-9
    # Worst where a sharp edge meets the roof.
    assert planes_m >= 0.55 * exact_m - 1e-9


@settings(max_examples=500)
@given(places, places, st.floats(-1.0, 4.0))
def test_a_way_enters_a_grown_hazard_where_its_points_say_so(start, end, grown_m):
    before, entered = crossing(
        HAZARDS.plane_distance_m(start) - grown_m, HAZARDS.normal @ (end - start)
    )
    share = np.linspace(0.0, 1.0, 400)
    points = start + share[:, None] * (end - start)
    inside = np.array([HAZARDS.plane_distance_m(point).max(axis=1) for point in points]) - grown_m
    depth_m = inside.min(axis=0)
    step_m = np.linalg.norm(end - start) / 399
    assert entered[depth_m < -1e-6].all()
    assert not entered[depth_m > step_m + 1e-9].any()
    for body in np.flatnonzero(depth_m < -1e-6):
        first = share[np.argmax(inside[:, body] < 0.0)]
        assert before[body] <= first + 1e-9


@settings(max_examples=500)
@given(places, st.floats(0.0, 40.0))
def test_no_hazard_within_reach_is_left_out(place, reach_m):
    distance_m = HAZARDS.plane_distance_m(place).max(axis=1)
    near = HAZARDS.offset_m[distance_m - HAZARDS.keep_m < reach_m]
    for aside in np.array([[0.0, 0.0], [3.0, 0.0], [-2.0, 2.0]]):
        found = HAZARDS.around(place[:2] + aside, reach_m + 3.0).offset_m.tolist()
        assert all(offset_m in found for offset_m in near.tolist())


def test_ground_and_box_are_hazards_of_their_own_kind():
    slack_m = HAZARDS.plane_distance_m(np.array([90.0, 10.0, 4.0])).max(axis=1) - HAZARDS.keep_m
    assert slack_m[HAZARDS.kind == Kind.GROUND].tolist() == [2.5]
    assert sorted(slack_m[HAZARDS.kind == Kind.FENCE]) == [8.0, 8.0, 74.0, 88.0, 88.0]


# -- candidates ---------------------------------------------------------------------------------


@settings(max_examples=200)
@given(velocities, st.integers(0, 2**32 - 1), st.integers(1, MAX_WALLS))
def test_within_walls_is_the_nearest_velocity(proposal, seed, num_walls):
    """Against random search: nothing that keeps all walls is nearer."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(num_walls, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    least = -rng.uniform(0.0, 3.0, num_walls)  # zero velocity always keeps them
    first = within_walls(proposal[None], normal, least)[0]
    assert (normal @ first >= least - 1e-5).all()
    others = proposal + rng.normal(size=(3000, 3)) * np.linalg.norm(first - proposal)
    kept = (others @ normal.T >= least).all(axis=1)
    np.testing.assert_array_equal(
        nearest_first(np.concatenate((others[kept], [first])), proposal)[0], first
    )


def test_walls_that_contradict_each_other_leave_only_what_comes_no_nearer():
    normal = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    found = within_walls(np.array([[1.0, 2.0, 0.0]]), normal, np.array([0.5, 0.5]))
    assert found == pytest.approx(np.array([[0.0, 2.0, 0.0]]), abs=1e-6)


def test_no_walls_no_candidates():
    assert within_walls(np.ones((1, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0, 3)


@pytest.mark.parametrize(
    "proposal", [[3.0, 0, 0], [0, 0, 2.0], [0, 0, -2.0], [0, 0, 0], [1, -2, 3]]
)
def test_the_fan_holds_rest_and_every_direction(proposal):
    velocity = fan(np.array(proposal, dtype=float), 1.0)
    assert (velocity == 0.0).all(axis=1).any()
    moving = velocity[np.linalg.norm(velocity, axis=1) > 1e-9]
    direction = moving / np.linalg.norm(moving, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    asked = rng.normal(size=(200, 3))
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    assert (asked @ direction.T).max(axis=1).min() > np.cos(np.radians(45.0))
