"""What carries a vehicle off: seen, leant against, and reckoned with."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.braking import Braking
from companion.guidance.drift import CALM, Drift, DriftObserver
from companion.guidance.shield import Shield, ShieldReason
from companion.guidance.shield_limits import ShieldLimits
from companion.world.maps import build_map
from sim.dynamics import VelocityLag, follow_velocity

LIMITS = ShieldLimits(v_max_mps=5.0, margin_m=2.0, lag_s=0.6, brake_mps2=1.6)
BRAKING = Braking(LIMITS.lag_s, LIMITS.brake_mps2)
SQUARE = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
BLOCKS = [
    np.array([[10.0, 10.0], [48.5, 10.0], [48.5, 90.0], [10.0, 90.0]]),
    np.array([[51.5, 10.0], [90.0, 10.0], [90.0, 90.0], [51.5, 90.0]]),
]
CITY = build_map("city", (100, 100, 100), [SQUARE], [30.0])
STREET = Shield(build_map("street", (100, 100, 60), BLOCKS, [40.0, 40.0]), LIMITS)
SHIELD = Shield(CITY, LIMITS)
EAST, REST = np.array([1.0, 0.0, 0.0]), np.zeros(3)
OPEN, AT_MARGIN = np.array([80.0, 20.0, 50.0]), np.array([38.0, 50.0, 15.0])

unit = st.floats(-1.0, 1.0)
velocities = st.tuples(unit, unit, unit).map(lambda v: 4.0 * np.array(v))
drifts = st.tuples(unit, unit, unit, st.floats(0.0, 3.0)).map(
    lambda d: Drift(1.6 * np.array(d[:3]), d[3])
)


def check(velocity, position, now=REST, drift=CALM, shield=SHIELD):
    return shield.check(velocity, position_enu_m=position, velocity_now_enu_mps=now, drift=drift)


def watched(velocities_mps, sent_mps, observer=None):
    """Return what an observer says after a row of velocities, one every 50 ms."""
    observer, drift = observer or DriftObserver(), CALM
    for velocity_mps in velocities_mps:
        drift = observer.update(np.array(velocity_mps), np.array(sent_mps), BRAKING, dt_s=0.05)
    return drift


# -- the observer -------------------------------------------------------------------------------


@given(velocities, velocities, st.floats(0.05, 1.0), st.floats(1.0, 4.0))
def test_a_vehicle_that_follows_does_not_drift(now, command, lag_share, brake_share):
    """As slowly as it was told to be, or quicker."""
    lag = VelocityLag(LIMITS.lag_s * lag_share, LIMITS.brake_mps2 * brake_share)
    observer = DriftObserver()
    for _ in range(60):
        drift = observer.update(now, command, BRAKING, dt_s=0.05)
        assert not drift.velocity_enu_mps.any()
        assert drift.gust_mps == 0.0
        now, _ = follow_velocity(now, command, lag, dt_s=0.05)


def test_what_is_left_of_a_velocity_is_the_drift():
    drift = watched([[0.0, 0.0, 0.0]] + 20 * [[1.2, 0.0, 0.0]], [0.0, 0.0, 0.0])
    assert drift.velocity_enu_mps == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert drift.gust_mps == pytest.approx(1.0)


def test_leaning_against_a_drift_does_not_hide_it():
    """Sent 1 m/s against it for long, the vehicle stands: all that it does is explained by both."""
    drift = watched(200 * [[0.0, 0.0, 0.0]], [-1.0, 0.0, 0.0])
    assert drift.velocity_enu_mps == pytest.approx([0.8, 0.0, 0.0], abs=1e-6)


def test_a_gust_is_remembered_and_forgotten():
    observer = DriftObserver()
    watched([[0.0, 0.0, 0.0]] + 5 * [[0.0, 1.2, 0.0]], [0.0, 0.0, 0.0], observer)
    after = watched([[0.0, 0.0, 0.0]], [0.0, 0.0, 0.0], observer)
    assert not after.velocity_enu_mps.any()
    assert after.gust_mps == pytest.approx(1.0, rel=0.01)
    minute = watched(1200 * [[0.0, 0.0, 0.0]], [0.0, 0.0, 0.0], observer)
    assert minute.gust_mps == pytest.approx(np.exp(-4.0), rel=0.01)


def test_noise_is_no_drift():
    rng = np.random.default_rng(0)
    drift = watched(rng.uniform(-0.1, 0.1, (200, 3)), [0.0, 0.0, 0.0])
    assert not drift.velocity_enu_mps.any()
    assert drift.gust_mps == 0.0


def test_nothing_is_said_of_a_vehicle_that_follows_somebody_else():
    observer = DriftObserver()
    for velocity in ([0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 5.0, 0.0]):
        drift = observer.update(np.array(velocity), None, BRAKING, dt_s=0.05)
        assert not drift.velocity_enu_mps.any()
    # And it begins where the vehicle is.
    drift = observer.update(
        np.array([0.0, 5.0, 0.0]), np.array([0.0, 5.0, 0.0]), BRAKING, dt_s=0.05
    )
    assert not drift.velocity_enu_mps.any()


@pytest.mark.parametrize("bad", [[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]])
def test_a_velocity_that_is_none_is_no_drift_and_leaves_no_trace(bad):
    observer = DriftObserver()
    watched(3 * [[0.0, 0.0, 0.0]], [0.0, 0.0, 0.0], observer)
    assert not watched([bad], [0.0, 0.0, 0.0], observer).velocity_enu_mps.any()
    assert not watched(3 * [[0.0, 0.0, 0.0]], [0.0, 0.0, 0.0], observer).velocity_enu_mps.any()


@given(st.lists(st.tuples(velocities, velocities, st.floats(0.0, 60.0)), max_size=20))
def test_a_drift_is_finite_and_bounded(seen):
    observer = DriftObserver()
    for velocity, sent, dt_s in seen:
        drift = observer.update(5.0 * velocity, sent, BRAKING, dt_s=dt_s)
        assert np.linalg.norm(drift.velocity_enu_mps) <= 2.8 + 1e-9
        assert np.linalg.norm(drift.velocity_enu_mps) - 1e-9 <= drift.gust_mps <= 2.8 + 1e-9


# -- the shield ---------------------------------------------------------------------------------


@given(velocities, drifts)
def test_far_from_everything_a_drift_changes_nothing(proposal, drift):
    calm, drifting = check(proposal, OPEN), check(proposal, OPEN, drift=drift)
    assert drifting.velocity_enu_mps.tolist() == calm.velocity_enu_mps.tolist()
    assert drifting.reason is calm.reason


@given(st.tuples(*[st.floats(2, 98)] * 3).map(np.array), velocities, velocities, drifts)
def test_whatever_the_drift_a_velocity_within_the_limits_leaves(position, now, proposal, drift):
    decision = check(proposal, position, now, drift)
    assert np.isfinite(decision.velocity_enu_mps).all()
    assert np.linalg.norm(decision.velocity_enu_mps) <= 5.0 + 1e-9
    assert -1.5 - 1e-9 <= decision.velocity_enu_mps[2] <= 3.0 + 1e-9


@pytest.mark.parametrize("proposal", [REST, 2.0 * EAST, np.full(3, np.nan)])
def test_at_the_margin_it_leans_against_a_drift_toward_the_wall(proposal):
    decision = check(proposal, AT_MARGIN, EAST, Drift(EAST, 1.0))
    # And moves away: at 1 m/s braking will have lost some of the margin.
    assert decision.velocity_enu_mps[0] < -1.5


@pytest.mark.parametrize("slack_m", [0.5, 1.0, 2.0])
def test_on_a_drift_away_from_a_wall_nothing_is_built(slack_m):
    here = AT_MARGIN - slack_m * EAST
    calm = check(5.0 * EAST, here).velocity_enu_mps
    drifting = check(5.0 * EAST, here, -EAST, Drift(-EAST, 1.0)).velocity_enu_mps
    assert 0.0 < drifting[0] <= calm[0] + 1e-9


@pytest.mark.parametrize("lost_m", [0.2, 0.8])
def test_inside_a_margin_no_drift_makes_it_lean_toward_the_wall(lost_m):
    here = AT_MARGIN + lost_m * EAST
    decision = check(5.0 * EAST, here, drift=Drift(-2.0 * EAST, 2.0))
    assert decision.velocity_enu_mps[0] <= 0.05


def test_after_gusts_it_comes_no_nearer_at_speed_but_as_near_in_the_end():
    for slack_m in np.linspace(0.1, 12.0, 40):
        here = AT_MARGIN - slack_m * EAST
        ahead_mps = [
            check(5.0 * EAST, here, drift=Drift(REST, gust_mps)).velocity_enu_mps[0]
            for gust_mps in (0.0, 0.5, 1.0, 2.0)
        ]
        assert all(after <= before + 1e-9 for before, after in pairwise(ahead_mps))
        # A stop from less takes no longer than the lag, and that the margin pays for.
        if ahead_mps[0] < LIMITS.brake_mps2 * LIMITS.lag_s:
            assert ahead_mps[-1] == pytest.approx(ahead_mps[0], abs=1e-9)


@pytest.mark.parametrize("drift_mps", [-1.0, -0.4, 0.4, 1.0])
def test_between_two_near_walls_it_flies_on_and_leans_against_the_drift(drift_mps):
    drift = Drift(drift_mps * EAST, abs(drift_mps))
    middle = np.array([50.0, 50.0, 10.0])
    decision = check(np.array([0.0, 2.0, 0.0]), middle, drift=drift, shield=STREET)
    # Not with all it takes: if the drift ends, the other wall is as near.
    assert 0.3 < decision.velocity_enu_mps[0] / -drift_mps < 1.0
    assert decision.velocity_enu_mps[1] > 0.9


@pytest.mark.parametrize("aside_m", [-0.8, -0.4, -0.2, 0.2, 0.4, 0.8])
def test_between_two_near_walls_it_keeps_to_the_middle(aside_m):
    place = np.array([50.0 + aside_m, 50.0, 10.0])
    decision = check(np.array([0.0, 2.0, 0.0]), place, shield=STREET)
    assert decision.velocity_enu_mps[0] * np.sign(aside_m) < -0.25
    assert decision.velocity_enu_mps[1] > 0.45


def blown(gust_mps, *, seen):
    """Return how much of the margin a lasting gust keeps from a vehicle that hovers at it."""
    observer, position, velocity, sent = DriftObserver(), AT_MARGIN, np.zeros(3), np.zeros(3)
    for _ in range(200):
        now = velocity + gust_mps * EAST
        drift = observer.update(now, sent, BRAKING, dt_s=0.05) if seen else CALM
        sent = check(REST, position, now, drift).velocity_enu_mps
        velocity, moved = follow_velocity(velocity, sent, VelocityLag(0.6, 1.6), dt_s=0.05)
        position = position + moved + 0.05 * gust_mps * EAST
    return 2.0 - float(CITY.obstacles.signed_distance_m(position))


@pytest.mark.parametrize("gust_mps", [0.5, 1.0, 1.5, 2.0])
def test_a_lasting_gust_that_is_seen_takes_next_to_nothing_of_the_margin(gust_mps):
    assert blown(gust_mps, seen=False) == pytest.approx(LIMITS.restore_s * gust_mps, rel=0.05)
    assert blown(gust_mps, seen=True) < 0.15


@settings(max_examples=200)
@given(st.tuples(*[st.floats(4, 96)] * 3).map(np.array), velocities, velocities, drifts)
def test_from_where_it_can_stop_in_a_drift_it_can_stop_after_one_more_step(
    position, now, proposal, drift
):
    """Whether the drift lasts or ends at once."""
    slowest, follow_s = VelocityLag(0.6, 1.6), LIMITS.period_s + LIMITS.reaction_s
    stopped = position + follow_velocity(now, REST, slowest, dt_s=1e3)[1]
    hard_s = max(0.0, float(np.linalg.norm(now)) / 1.6 - 0.6)
    if not (
        CITY.is_free(np.array([position, stopped]), 2.9 + hard_s * drift.gust_mps).all()
        and stopped.min() > 2.9 + hard_s * drift.gust_mps
        and stopped.max() < 97.1 - hard_s * drift.gust_mps
    ):
        return  # 2.9: what the planes of a convex hazard give away at its edges
    command = check(proposal, position, now, drift).velocity_enu_mps
    lasting, moved = follow_velocity(now, command + drift.velocity_enu_mps, slowest, dt_s=follow_s)
    for begin, velocity in ((position + moved, lasting), (position + follow_s * command, command)):
        rest = begin + follow_velocity(velocity, REST, slowest, dt_s=1e3)[1]
        for end in (begin, rest):
            assert CITY.obstacles.signed_distance_m(end) >= 2.0 - 2e-3
            assert end.min() >= 2.0 - 2e-3
            assert end.max() <= 98.0 + 2e-3


def test_the_reason_is_that_of_the_command_and_not_of_the_leaning():
    """Held at the margin against a drift it is blocked, however much it leans."""
    decision = check(1.0 * EAST, AT_MARGIN, REST, Drift(EAST, 1.0))
    assert decision.velocity_enu_mps == pytest.approx(-EAST, abs=1e-6)
    assert decision.reason is ShieldReason.BLOCKED
