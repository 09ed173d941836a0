from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.shield import Shield, ShieldDecision, ShieldReason
from companion.guidance.shield_limits import ShieldLimits
from companion.world.maps import build_map
from sim.dynamics import VelocityLag, follow_velocity

LIMITS = ShieldLimits(v_max_mps=5.0, margin_m=2.0, lag_s=0.6, brake_mps2=1.6)
SQUARE = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
U = np.array([[5, 60], [35, 60], [35, 90], [27, 90], [27, 68], [13, 68], [13, 90], [5, 90]], float)
CITY = build_map("city", (100, 100, 100), [SQUARE, U], [30.0, 40.0])
EMPTY = build_map("empty", (100, 100, 100), [], [])
SHIELD = Shield(CITY, LIMITS)
AT_REST = np.zeros(3)


def check(velocity, position, now=AT_REST, shield=SHIELD) -> ShieldDecision:
    return shield.check(velocity, position_enu_m=position, velocity_now_enu_mps=now)


def stopping_way_m(speed_mps: float) -> float:
    """From the proposal on: followed for a period and the reaction time, then stopped."""
    knee_mps = min(speed_mps, LIMITS.brake_mps2 * LIMITS.lag_s)
    limited_m = (speed_mps**2 - knee_mps**2) / (2 * LIMITS.brake_mps2)
    return speed_mps * (LIMITS.period_s + LIMITS.reaction_s) + limited_m + knee_mps * LIMITS.lag_s


# -- what passes, and what never does -----------------------------------------------------------


def test_a_proposal_far_from_everything_passes_bit_for_bit():
    decision = check(np.array([3.0, -2.0, 1.0]), np.array([80.0, 20.0, 50.0]))
    assert decision.velocity_enu_mps.tolist() == [3.0, -2.0, 1.0]
    assert not decision.intervened
    assert decision.reason is ShieldReason.CLEAR


@pytest.mark.parametrize(
    "proposal",
    [
        np.full(3, np.nan),
        np.array([1.0, np.inf, 0.0]),
        np.array([0.0, 0.0, -np.inf]),
        np.zeros(2),
        np.zeros((1, 3)),
        1.0,
        None,
        "up",
        [[1.0], [2.0, 3.0]],
        [1.0, 2.0, 1j],
        np.array([1.0, 2.0, None]),
    ],
)
def test_what_is_not_three_finite_numbers_is_a_hold(proposal):
    decision = check(proposal, np.array([80.0, 20.0, 50.0]))
    assert decision.velocity_enu_mps.tolist() == [0.0, 0.0, 0.0]
    assert decision.intervened
    assert decision.reason is ShieldReason.NOT_FINITE


@pytest.mark.parametrize("bad", [np.full(3, np.nan), np.array([1.0, 2.0, np.inf]), None, [1.0]])
def test_a_state_that_is_not_finite_is_a_hold(bad):
    here, east = np.array([80.0, 20.0, 50.0]), np.array([1.0, 0.0, 0.0])
    for decision in (check(east, bad), check(east, here, now=bad)):
        assert decision.velocity_enu_mps.tolist() == [0.0, 0.0, 0.0]
        assert decision.intervened
        assert decision.reason is ShieldReason.STATE_INVALID


@pytest.mark.parametrize(
    ("proposal", "expected"),
    [
        ([5.0, 0.0, 0.0], [5.0, 0.0, 0.0]),
        ([5.0 + 1e-3, 0.0, 0.0], [5.0, 0.0, 0.0]),
        ([30.0, 40.0, 0.0], [3.0, 4.0, 0.0]),
        ([1e300, 0.0, 0.0], [5.0, 0.0, 0.0]),
        ([0.0, 0.0, 3.0], [0.0, 0.0, 3.0]),
        ([0.0, 2.0, 4.0], [0.0, 1.5, 3.0]),
        ([0.0, 0.0, -1.5], [0.0, 0.0, -1.5]),
        ([2.0, 0.0, -3.0], [1.0, 0.0, -1.5]),
    ],
)
def test_too_fast_is_slowed_down_and_not_turned(proposal, expected):
    decision = check(np.array(proposal), np.array([80.0, 20.0, 50.0]))
    assert decision.velocity_enu_mps == pytest.approx(expected, rel=1e-12)
    limited = proposal != expected
    assert decision.intervened is limited
    assert decision.reason is (ShieldReason.LIMITED if limited else ShieldReason.CLEAR)


@pytest.mark.parametrize("name", ShieldLimits.__slots__)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_limits_are_positive_numbers(name, value):
    with pytest.raises(ValueError, match=name):
        ShieldLimits(**{name: value})


# -- surfaces -----------------------------------------------------------------------------------

FACES = [  # a point 2 m + slack from a face, the direction toward it, why it is not entered
    pytest.param([30.0, 50.0, 15.0], [1, 0, 0], 8.0, ShieldReason.OBSTACLE, id="wall"),
    pytest.param([50.0, 50.0, 40.0], [0, 0, -1], 8.0, ShieldReason.OBSTACLE, id="roof"),
    pytest.param([20.0, 76.0, 10.0], [0, -1, 0], 6.0, ShieldReason.OBSTACLE, id="court"),
    pytest.param([80.0, 20.0, 9.0], [0, 0, -1], 7.0, ShieldReason.GROUND, id="ground"),
    pytest.param([90.0, 20.0, 20.0], [1, 0, 0], 8.0, ShieldReason.FENCE, id="east"),
    pytest.param([80.0, 10.0, 20.0], [0, -1, 0], 8.0, ShieldReason.FENCE, id="south"),
    pytest.param([10.0, 20.0, 20.0], [-1, 0, 0], 8.0, ShieldReason.FENCE, id="west"),
    pytest.param([80.0, 90.0, 20.0], [0, 1, 0], 8.0, ShieldReason.FENCE, id="north"),
    pytest.param([80.0, 20.0, 90.0], [0, 0, 1], 8.0, ShieldReason.FENCE, id="top"),
]


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES)
def test_the_approach_is_as_fast_as_the_stop_allows(position, toward, slack_m, reason):
    position, toward = np.array(position), np.array(toward, dtype=float)
    top_mps = 1.5 if toward[2] < 0 else 3.0 if toward[2] > 0 else 5.0
    for speed_mps in np.linspace(0.1, 1.0, 10) * top_mps:
        room_m = stopping_way_m(speed_mps)
        here = position + toward * (slack_m - room_m)  # the stop ends at the margin
        assert not check(speed_mps * toward, here - 0.02 * toward).intervened
        nearer = check(speed_mps * toward, here + 0.02 * toward)
        assert nearer.intervened
        assert nearer.reason is reason
        assert 0.0 < nearer.velocity_enu_mps @ toward < speed_mps


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES)
def test_at_the_margin_it_slides_along(position, toward, slack_m, reason):
    position, toward = np.array(position), np.array(toward, dtype=float)
    along = np.array([0.0, 1.0, 0.0]) if abs(toward[1]) < 0.5 else np.array([1.0, 0.0, 0.0])
    decision = check(1.0 * toward + 0.5 * along, position + slack_m * toward)
    assert decision.velocity_enu_mps == pytest.approx(0.5 * along, abs=1e-6)
    assert decision.reason is reason


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES)
def test_head_on_at_the_margin_it_is_blocked(position, toward, slack_m, reason):
    position, toward = np.array(position), np.array(toward, dtype=float)
    decision = check(1.5 * toward, position + slack_m * toward)
    assert np.abs(decision.velocity_enu_mps).max() < 1e-6
    assert decision.reason is ShieldReason.BLOCKED


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES)
@pytest.mark.parametrize("lost_m", [0.3, 1.0, 1.7])
def test_inside_the_margin_only_outward(position, toward, slack_m, reason, lost_m):
    position, toward = np.array(position), np.array(toward, dtype=float)
    here = position + (slack_m + lost_m) * toward
    for proposal in (1.5 * toward, np.zeros(3), np.array([0.3, 0.4, 0.0]), np.full(3, np.nan)):
        decision = check(proposal, here)
        assert decision.velocity_enu_mps @ toward < -0.1
        assert decision.intervened
    assert not check(-3.0 * toward if toward[2] <= 0 else -1.5 * toward, here).intervened


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES)
@pytest.mark.parametrize("drift_mps", [0.0, 1.4])
def test_full_speed_along_a_lost_margin_leaves_room_for_the_way_out(
    position, toward, slack_m, reason, drift_mps
):
    position, toward = np.array(position), np.array(toward, dtype=float)
    here = position + (slack_m + 0.8) * toward
    along = np.array([0.0, 1.0, 0.0]) if abs(toward[1]) < 0.5 else np.array([1.0, 0.0, 0.0])
    decision = check(5.0 * along, here, drift_mps * toward)
    assert -decision.velocity_enu_mps @ toward > (1.2 if drift_mps == 0.0 else 1.45)
    if drift_mps == 0.0:
        assert decision.velocity_enu_mps @ along > 2.0
    else:
        # More than half the margin will be lost: what leads out has the vehicle's acceleration.
        assert decision.reason is ShieldReason.EMERGENCY
        assert decision.velocity_enu_mps @ along == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("position", "toward", "slack_m", "reason"), FACES[3:])
def test_outside_the_box_only_back(position, toward, slack_m, reason):
    position, toward = np.array(position), np.array(toward, dtype=float)
    beyond = position + (slack_m + 2.0 + 5.0) * toward
    for proposal in (1.5 * toward, np.zeros(3), np.array([0.1, 0.1, 0.1])):
        decision = check(proposal, beyond)
        assert decision.velocity_enu_mps @ toward < -1.0


def test_inside_an_obstacle_it_goes_to_the_nearest_surface():
    for place, way in (
        ([41.0, 50.0, 10.0], [-1, 0, 0]),
        ([50.0, 59.5, 10.0], [0, 1, 0]),
        ([50.0, 50.0, 29.0], [0, 0, 1]),
        ([9.0, 75.0, 39.5], [0, 0, 1]),
    ):
        decision = check(np.array([2.0, 0.0, 0.0]), np.array(place))
        assert decision.reason is ShieldReason.EMERGENCY
        assert decision.clearance_m < 0.0
        assert decision.velocity_enu_mps @ np.array(way) > 1.0
        assert np.linalg.norm(np.cross(decision.velocity_enu_mps, way)) < 1e-9


def test_a_corner_is_flown_round():
    """West of the block, wanting east-north-east: along the wall, and round it once past."""
    velocity, position = np.zeros(3), np.array([38.0, 55.0, 15.0])
    for _ in range(300):
        decision = check(np.array([3.0, 1.0, 0.0]), position, velocity)
        velocity, moved = follow_velocity(
            velocity, decision.velocity_enu_mps, VelocityLag(0.6, 1.6), dt_s=0.05
        )
        position = position + moved
    assert position[0] > 50.0
    assert CITY.obstacles.signed_distance_m(position) > 1.99


@pytest.mark.parametrize("wish", [[4.0, 0.0, 0.0], [4.0, 0.0, -0.8], [3.0, 2.0, -0.5]])
def test_a_roof_is_flown_over_by_who_has_come_up_to_it(wish):
    """Half a metre above the roof, beside the wall: a policy sees a free way there."""
    velocity, position = np.zeros(3), np.array([37.9, 50.0, 30.5])
    for _ in range(120):
        decision = check(np.array(wish), position, velocity)
        velocity, moved = follow_velocity(
            velocity, decision.velocity_enu_mps, VelocityLag(0.6, 1.6), dt_s=0.05
        )
        position = position + moved
        assert CITY.obstacles.signed_distance_m(position) > 1.99
    assert position[0] > 45.0


def test_who_cannot_stop_before_a_thin_wall_does_not_go_through_it():
    """However little of it is inside the wall, the way through is the worst of all."""
    wall = np.array([[50.0, 10.0], [50.2, 10.0], [50.2, 90.0], [50.0, 90.0]])
    shield = Shield(build_map("thin", (100, 100, 60), [wall], [55.0]), LIMITS)
    for ahead_m in np.linspace(0.3, 8.0, 30):
        position = np.array([50.0 - ahead_m, 50.0, 20.0])
        for side_mps in (0.0, 1.0, -3.0):
            now = np.array([5.0, side_mps, 0.0])
            for proposal in (now, np.array([5.0, 0.0, 3.0]), np.zeros(3)):
                decision = check(proposal, position, now, shield)
                assert decision.reason is ShieldReason.EMERGENCY
                assert decision.velocity_enu_mps[0] <= -1.0


def test_a_street_narrower_than_two_margins_is_flown_along_but_not_entered():
    blocks = [
        np.array([[10.0, 10.0], [48.5, 10.0], [48.5, 90.0], [10.0, 90.0]]),
        np.array([[51.5, 10.0], [90.0, 10.0], [90.0, 90.0], [51.5, 90.0]]),
    ]
    shield = Shield(build_map("street", (100, 100, 60), blocks, [40.0, 40.0]), LIMITS)
    north = np.array([0.0, 2.0, 0.0])
    inside = check(north, np.array([50.0, 50.0, 10.0]), shield=shield)
    assert inside.velocity_enu_mps[1] > 1.0
    aside = check(north, np.array([49.5, 50.0, 10.0]), shield=shield)
    assert aside.velocity_enu_mps[1] > 0.5
    assert aside.velocity_enu_mps[0] >= -1e-6
    before = check(north, np.array([50.0, 8.665, 10.0]), shield=shield)
    assert before.reason is ShieldReason.BLOCKED


def test_too_late_to_stop_is_an_emergency_that_brakes():
    decision = check(np.array([5.0, 0, 0]), np.array([35.0, 50.0, 15.0]), np.array([5.0, 0, 0]))
    assert decision.reason is ShieldReason.EMERGENCY
    assert decision.velocity_enu_mps[0] < -1.0


def test_clearance_is_that_of_the_nearest_thing_to_hit():
    assert check(AT_REST, np.array([30.0, 50.0, 15.0])).clearance_m == pytest.approx(10.0)
    assert check(AT_REST, np.array([80.0, 20.0, 3.0])).clearance_m == pytest.approx(3.0)
    empty = check(AT_REST, np.array([80.0, 20.0, 7.0]), shield=Shield(EMPTY, LIMITS))
    assert empty.clearance_m == pytest.approx(7.0)


# -- properties ---------------------------------------------------------------------------------

numbers = st.floats(allow_nan=True, allow_infinity=True)
anything = st.tuples(numbers, numbers, numbers)


@given(anything, anything, anything)
def test_whatever_comes_in_a_finite_velocity_within_the_limits_leaves(proposal, position, now):
    decision = check(proposal, position, now)
    assert np.isfinite(decision.velocity_enu_mps).all()
    assert np.linalg.norm(decision.velocity_enu_mps) <= 5.0 + 1e-9
    assert -1.5 - 1e-9 <= decision.velocity_enu_mps[2] <= 3.0 + 1e-9


unit = st.floats(-1.0, 1.0)
places = st.tuples(st.floats(2, 98), st.floats(2, 98), st.floats(2, 60)).map(np.array)
velocities = st.tuples(unit, unit, unit).map(lambda v: 4.0 * np.array(v))


def way_to_rest(position, velocity, command, lag, *, follow_s):
    """Return where a vehicle comes that follows a command for a while and then stops."""
    path = [position]
    for step in range(200):
        wanted = command if step * 0.05 < follow_s - 1e-9 else np.zeros(3)
        velocity, moved = follow_velocity(velocity, wanted, lag, dt_s=0.05)
        path.append(path[-1] + moved)
    return np.array(path)


@settings(max_examples=300)
@given(places, velocities, velocities, st.floats(0.05, 1.0), st.floats(1.0, 4.0))
def test_from_where_it_can_stop_it_can_stop_after_one_more_step(
    position, now, proposal, lag_share, brake_share
):
    """The invariant that keeps every flight safe, against the simulator's own dynamics."""
    slowest = VelocityLag(LIMITS.lag_s, LIMITS.brake_mps2)
    stop = way_to_rest(position, now, np.zeros(3), slowest, follow_s=0.0)
    if not (CITY.is_free(stop, 2.9).all() and ((stop > 2.0) & (stop < 98.0)).all()):
        return  # 2.9: what the planes of a convex hazard give away at its edges
    decision = check(proposal, position, now)
    follow_s = LIMITS.period_s + LIMITS.reaction_s
    for lag in (
        slowest,
        VelocityLag(LIMITS.lag_s * lag_share, LIMITS.brake_mps2 * brake_share),
    ):
        path = way_to_rest(position, now, decision.velocity_enu_mps, lag, follow_s=follow_s)
        # A quicker vehicle first follows and then stops within the model's bounds, up to this.
        tolerance_m = 2e-3 if lag is slowest else 0.1
        assert CITY.obstacles.signed_distance_m(path).min() >= 2.0 - tolerance_m
        assert path.min() >= 2.0 - tolerance_m
        assert (CITY.size_m - path).min() >= 2.0 - tolerance_m


@settings(max_examples=200)
@given(places, velocities, velocities)
def test_the_shield_remembers_nothing(position, now, proposal):
    first = check(proposal, position, now)
    check(-proposal, position + 1.0, -now)
    again = check(proposal, position, now, shield=Shield(CITY, LIMITS))
    assert first.velocity_enu_mps.tolist() == again.velocity_enu_mps.tolist()
    assert (first.reason, first.intervened) == (again.reason, again.intervened)


@settings(max_examples=200)
@given(places, velocities)
def test_what_it_lets_through_it_lets_through_again(position, proposal):
    if not CITY.is_free(position, 3.0):
        return
    once = check(proposal, position).velocity_enu_mps
    assert check(once, position).velocity_enu_mps == pytest.approx(once, abs=1e-9)


def test_nearer_is_never_faster():
    ahead = [
        check(np.array([5.0, 0.0, 0.0]), np.array([x, 50.0, 15.0])).velocity_enu_mps[0]
        for x in np.linspace(20.0, 38.0, 60)
    ]
    assert all(near <= far + 1e-9 for far, near in pairwise(ahead))


# -- a vehicle that turns out slower ----------------------------------------------------------


def test_a_longer_lag_that_was_measured_is_reckoned_with_and_a_shorter_one_not():
    shield = Shield(CITY, LIMITS)
    at, ahead = np.array([33.0, 50.0, 10.0]), np.array([3.0, 0.0, 0.0])
    told = check(ahead, at, ahead, shield)
    shield.reckon_with_lag(0.5 * LIMITS.lag_s)
    assert shield.limits == LIMITS
    shield.reckon_with_lag(3.0 * LIMITS.lag_s)
    slower = check(ahead, at, ahead, shield)
    assert slower.velocity_enu_mps[0] < told.velocity_enu_mps[0]
    afresh = Shield(CITY, replace(LIMITS, lag_s=3.0 * LIMITS.lag_s))
    expected = check(ahead, at, ahead, afresh)
    np.testing.assert_array_equal(slower.velocity_enu_mps, expected.velocity_enu_mps)
