"""The loop over a simulated vehicle in virtual time: whole flights in a blink."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.control import Flight, Mission
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Plan
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.session.records import Event, Tick
from companion.vehicle import FlightMode, RequestKind, SystemStatus
from companion.world.maps import build_map, load_map
from sim.dynamics import Disturbance
from sim.targets import TargetPaths, random_paths
from sim.vehicle import SimVehicle

FREE, ENV1 = load_map("free"), load_map("env1")
FROM_GROUND = Plan(engage=True, arm=True, takeoff_m=15.0)


class Spy:
    """A vehicle that notes when setpoints leave, and lets a test act at a given time."""

    def __init__(self, vehicle, at=None):
        self.vehicle = vehicle
        self.at = dict(at or {})
        self.sent = []

    def __getattr__(self, name):
        return getattr(self.vehicle, name)

    def wait_until(self, deadline_s):
        for time_s in [t for t in self.at if t <= deadline_s]:
            self.vehicle.wait_until(time_s)
            self.at.pop(time_s)(self.vehicle)
        self.vehicle.wait_until(deadline_s)

    def send_velocity(self, velocity_ned_mps, yaw_rad=None):
        self.sent.append((self.now_s(), np.array(velocity_ned_mps)))
        self.vehicle.send_velocity(velocity_ned_mps, yaw_rad)


def fly(
    actor_path,
    *,
    city=FREE,
    target=(80.0, 80.0, 15.0),
    plan=FROM_GROUND,
    at=None,
    vehicle=None,
    source=None,
    stop_at_s=np.inf,
    v_max_mps=5.0,
):
    spy = Spy(vehicle or SimVehicle(city, rng=np.random.default_rng(1)), at)
    records = []
    flight = Flight(
        spy,
        Mission(
            map=city,
            actor=Actor.load(actor_path),
            plan=plan,
            target=source or TargetSource(np.array(target)),
            v_max_mps=v_max_mps,
            rate_hz=20.0,
        ),
        Shield(city, ShieldLimits(v_max_mps=v_max_mps)),
        record=records.append,
        stop_requested=lambda: spy.now_s() >= stop_at_s,
    )
    return flight.run(), spy, records


def test_from_the_ground_to_the_target_and_hold(constant_actor):
    summary, spy, _ = fly(constant_actor())
    assert (summary.outcome, summary.exit_code) == ("arrived", 0)
    assert spy.state().mode is FlightMode.HOLD
    assert summary.final_distance_m < 5.0
    assert 80.0 < summary.distance_flown_m < 130.0
    assert summary.max_speed_mps <= 5.0 + 1e-6


def test_by_default_nothing_moves(constant_actor):
    summary, spy, _ = fly(constant_actor(), plan=Plan(), stop_at_s=30.0)
    assert (summary.outcome, summary.exit_code) == ("stopped", 130)
    assert all(not velocity.any() for _, velocity in spy.sent)
    assert not spy.state().armed


def test_the_pilot_arms_takes_off_and_selects_offboard(constant_actor):
    vehicle = SimVehicle(
        FREE,
        rng=np.random.default_rng(2),
        start_enu_m=np.array([20.0, 20.0, 15.0]),
        airborne=True,
    )
    at = {4.0: lambda v: v.take_over(FlightMode.EXTERNAL)}
    summary, spy, _ = fly(constant_actor(), plan=Plan(), vehicle=vehicle, at=at)
    assert summary.outcome == "arrived"
    assert all(not velocity.any() for time_s, velocity in spy.sent if time_s < 4.0)


@settings(max_examples=20, deadline=None)
@given(
    takeover_s=st.floats(0.5, 24.0),
    mode=st.sampled_from([FlightMode.HOLD, FlightMode.OTHER, FlightMode.LAND, FlightMode.RETURN]),
)
def test_takeover_at_any_moment_is_never_followed_by_a_setpoint(tmp_path_factory, takeover_s, mode):
    summary, spy, _ = fly(ACTOR[0], at={takeover_s: lambda v: v.take_over(mode)}, plan=FROM_GROUND)
    seen_s = takeover_s + 0.05  # the tick in which the heartbeat is decoded
    if summary.outcome == "stood_down":
        assert summary.exit_code == 7
        assert summary.takeovers == 1
        assert not [time_s for time_s, _ in spy.sent if time_s > seen_s]
    else:
        # Before anything was ours to lose: the vehicle is on the ground or still climbing in HOLD.
        assert not spy.state().armed or summary.outcome in ("arrived", "command_failed")


ACTOR = []


@pytest.fixture(autouse=True)
def _actor(constant_actor):
    ACTOR[:] = [constant_actor()]


def test_a_broken_policy_never_moves_the_vehicle(constant_actor, monkeypatch):
    actor = constant_actor()
    monkeypatch.setattr(Actor, "act", lambda self, _: np.full(3, np.nan, dtype=np.float32))
    summary, spy, _ = fly(actor)
    assert (summary.outcome, summary.exit_code) == ("failed", 8)
    assert all(np.isfinite(velocity).all() for _, velocity in spy.sent)
    assert all(not velocity.any() for _, velocity in spy.sent)


class Seldom(Spy):
    """Tells a new position in every third tick only."""

    looks, known = 0, None

    def state(self):
        if self.looks % 3 == 0:
            self.known = self.vehicle.state()
        self.looks += 1
        return self.known


def test_the_policy_is_asked_once_for_each_position_and_answers_every_tick(
    constant_actor, monkeypatch
):
    asked = []
    act = Actor.act
    monkeypatch.setattr(Actor, "act", lambda self, seen: asked.append(1) or act(self, seen))
    vehicle = Seldom(SimVehicle(FREE, rng=np.random.default_rng(1)))
    asked.clear()
    summary, _, records = fly(constant_actor(), vehicle=vehicle)
    ticks = [record for record in records if isinstance(record, Tick)]
    assert summary.outcome == "arrived"
    assert all(tick.action for tick in ticks)
    assert len(ticks) / 3 - 1 <= len(asked) <= len(ticks) / 3 + 1


def test_straight_at_an_obstacle_never_touches_it(constant_actor):
    summary, spy, records = fly(constant_actor(), city=ENV1, target=(85.0, 80.0, 15.0))
    assert spy.contacts == 0
    assert summary.min_clearance_m > 1.0
    assert summary.shield_interventions > 0
    assert sum(summary.shield_reasons.values()) == summary.shield_interventions
    assert any(record.shield_reason for record in records if isinstance(record, Tick))


@pytest.mark.parametrize(
    ("target", "says"),
    [((20.0, 20.0, 150.0), "outside"), ((-5.0, 20.0, 10.0), "outside")],
)
def test_a_target_outside_the_map_is_refused_before_anything_moves(constant_actor, target, says):
    summary, spy, _ = fly(constant_actor(), target=target)
    assert (summary.outcome, summary.exit_code) == ("refused", 5)
    assert says in summary.reason
    assert not spy.sent


def test_a_vehicle_outside_the_map_is_refused(constant_actor):
    vehicle = SimVehicle(FREE, rng=np.random.default_rng(3))
    vehicle._position_enu_m[:] = [-30.0, 20.0, 0.0]
    summary, spy, _ = fly(constant_actor(), vehicle=vehicle)
    assert (summary.outcome, summary.exit_code) == ("refused", 5)
    assert "outside map free" in summary.reason
    assert not spy.sent


def test_takeoff_under_the_lid_only(constant_actor):
    plan = Plan(engage=True, arm=True, takeoff_m=99.5)
    summary, _, _ = fly(constant_actor(), plan=plan)
    assert summary.outcome == "refused"
    assert "take-off" in summary.reason


def test_a_moving_target_is_caught(constant_actor):
    rng = np.random.default_rng(5)
    paths = random_paths(FREE, rng, 1, speed_mps=(1.0, 1.5))
    assert isinstance(paths, TargetPaths)
    vehicle = SimVehicle(FREE, rng=rng, targets={42: paths})
    summary, _, records = fly(
        constant_actor((1.0, 0.0, 0.0)), vehicle=vehicle, source=TargetSource(system_id=42),
        stop_at_s=120.0,
    )  # fmt: skip
    ticks = [record for record in records if isinstance(record, Tick)]
    assert ticks[-1].target_enu_m is not None
    horizontal_m = np.hypot(*(np.array(ticks[-1].target_enu_m) - ticks[-1].position_enu_m)[:2])
    assert summary.outcome == "arrived" or horizontal_m < 5.0


def test_a_target_never_heard_is_waited_for_and_then_refused(constant_actor, caplog):
    caplog.set_level("INFO", "companion")
    summary, spy, records = fly(constant_actor(), source=TargetSource(system_id=42))
    assert (summary.outcome, summary.exit_code) == ("refused", 5)
    assert summary.reason_code == "not_ready"
    assert "42" in summary.reason
    assert not spy.sent
    events = [record for record in records if isinstance(record, Event)]
    assert "42" in events[0].text
    assert events[0].time_s < 1.0
    again = [record.message for record in caplog.records if "of 90 s" in record.message]
    assert 7 <= len(again) <= 9
    assert "10 s of 90 s" in again[0]


class Silent(Spy):
    """Hears nothing more of its target after 12 s."""

    heard = None

    def targets(self):
        if self.now_s() < 12.0:
            self.heard = dict(self.vehicle.targets())
        return self.heard


def test_a_hold_beside_a_wall_goes_through_the_shield(constant_actor):
    """Zero alone would leave the vehicle to the gusts, inside the margin as well."""
    wall_m = np.array([[40.0, 30.0], [60.0, 30.0], [60.0, 31.0], [40.0, 31.0]])
    launch_m = np.array([50.0, 25.0, 0.0])
    city = build_map("wall", (100, 100, 60), [wall_m], [40.0], launch_enu_m=launch_m)
    vehicle = SimVehicle(
        city,
        rng=np.random.default_rng(3),
        start_enu_m=np.array([50.0, 25.0, 20.0]),
        airborne=True,
        wind=Disturbance(std=0.5, correlation_s=4.0),
        targets={42: TargetPaths.resting(np.array([[50.0, 80.0, 20.0]]))},
    )
    _, _, records = fly(
        constant_actor((1.0, 0.0, 0.0)), city=city, plan=Plan(engage=True),
        vehicle=Silent(vehicle), source=TargetSource(system_id=42), stop_at_s=20.0,
    )  # fmt: skip
    held = [tick for tick in records if isinstance(tick, Tick) and tick.supervisor == "holding"]
    assert len(held) > 100
    left_out = [tick for tick in held if np.any(tick.safe_enu_mps)]
    assert left_out
    assert all(tick.shield_reason and tick.intervened for tick in left_out)
    assert min(tick.clearance_m for tick in held) > 1.0


def test_a_hand_over_beside_a_wall_goes_through_the_shield(constant_actor):
    wall_m = np.array([[40.0, 30.0], [60.0, 30.0], [60.0, 31.0], [40.0, 31.0]])
    launch_m = np.array([50.0, 28.5, 0.0])
    city = build_map("wall", (100, 100, 60), [wall_m], [40.0], launch_enu_m=launch_m)
    vehicle = SimVehicle(
        city,
        rng=np.random.default_rng(3),
        start_enu_m=np.array([50.0, 28.5, 20.0]),
        airborne=True,
    )
    summary, _, records = fly(
        constant_actor((1.0, 0.0, 0.0)), city=city, plan=Plan(engage=True), vehicle=vehicle,
        target=(50.0, 80.0, 20.0), stop_at_s=1.2,
    )  # fmt: skip
    assert summary.outcome == "stopped"
    leaving = [tick for tick in records if isinstance(tick, Tick) and "handing" in tick.supervisor]
    assert leaving
    assert all(tick.safe_enu_mps[1] < 0.0 for tick in leaving if tick.clearance_m < 1.9)
    assert leaving[0].clearance_m < 1.9


def test_signal_hands_over(constant_actor):
    summary, spy, _ = fly(constant_actor(), stop_at_s=12.0)
    assert (summary.outcome, summary.exit_code) == ("stopped", 130)
    assert spy.state().mode is FlightMode.HOLD


def test_landing_on_exit(constant_actor):
    plan = Plan(engage=True, arm=True, takeoff_m=15.0, on_exit=RequestKind.LAND)
    summary, spy, _ = fly(constant_actor(), plan=plan)
    assert summary.outcome == "arrived"
    assert spy.state().mode is FlightMode.LAND


def test_every_phase_is_announced_and_recorded(constant_actor):
    _, spy, records = fly(constant_actor())
    said = [text for _, _, text in spy.said]
    events = [record.text for record in records if isinstance(record, Event)]
    for phase in ("arming", "taking off", "engaging", "engaged", "handing over", "done"):
        assert any(text.startswith(phase) for text in said), phase
        assert any(text.startswith(phase) for text in events), phase
    assert {status for _, status in spy.heartbeats} >= {SystemStatus.ACTIVE}


def test_heartbeat_once_a_second(constant_actor):
    _, spy, _ = fly(constant_actor())
    gaps_s = np.diff([time_s for time_s, _ in spy.heartbeats])
    assert gaps_s.max() < 1.1
    assert gaps_s.min() > 0.9


def test_shadow_sends_nothing(constant_actor):
    vehicle = SimVehicle(
        FREE,
        rng=np.random.default_rng(2),
        start_enu_m=np.array([20.0, 20.0, 15.0]),
        airborne=True,
    )
    summary, spy, records = fly(
        constant_actor(), plan=Plan(shadow=True), vehicle=vehicle, stop_at_s=10.0
    )
    assert not spy.sent
    assert not spy.said
    assert summary.setpoints_sent == 0
    ticks = [record for record in records if isinstance(record, Tick)]
    assert any(tick.proposed_enu_mps for tick in ticks)


def test_same_flight_twice_is_the_same_flight(constant_actor):
    actor = constant_actor()
    first, second = fly(actor, city=ENV1)[1], fly(actor, city=ENV1)[1]
    np.testing.assert_array_equal(
        [velocity for _, velocity in first.sent], [velocity for _, velocity in second.sent]
    )
