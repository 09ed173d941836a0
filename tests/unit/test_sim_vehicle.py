import numpy as np
import pytest

from companion.vehicle import (
    EventKind,
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    Severity,
    SystemStatus,
    Vehicle,
)
from companion.world.frames import GeoPoint, LocalTie, geodetic_to_enu
from companion.world.maps import build_map
from sim.dynamics import Disturbance, VelocityLag
from sim.targets import TargetPaths
from sim.vehicle import NOWHERE, SimVehicle

TOWER = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
NORTH_NED = np.array([2.0, 0.0, 0.0])


def make_city(**place):
    place = place or {"launch_enu_m": [5.0, 5.0, 0.0]}
    return build_map("tower", [100, 100, 100], [TOWER], [30.0], **place)


def make_vehicle(city=None, *, seed=0, **options):
    return SimVehicle(city or make_city(), rng=np.random.default_rng(seed), **options)


def ask(vehicle, kind, **options):
    vehicle.request(kind, **options)
    vehicle.wait_until(vehicle.now_s() + 0.1)
    return vehicle.request_status().state


def stream(vehicle, velocity_ned_mps, duration_s, period_s=0.05):
    end_s = vehicle.now_s() + duration_s
    while vehicle.now_s() < end_s - 1e-9:
        vehicle.send_velocity(velocity_ned_mps)
        vehicle.wait_until(vehicle.now_s() + period_s)


def engaged(**options):
    """Return a vehicle in the air and in external mode."""
    options.setdefault("start_enu_m", np.array([20.0, 20.0, 20.0]))
    vehicle = make_vehicle(airborne=True, **options)
    vehicle.send_velocity(np.zeros(3))
    assert ask(vehicle, RequestKind.EXTERNAL) is RequestState.CONFIRMED
    return vehicle


def test_it_is_a_vehicle():
    vehicle: Vehicle = make_vehicle()
    assert vehicle.info.needs_stream_before_external
    assert vehicle.state().mode is FlightMode.HOLD


def test_time_is_virtual_and_exact():
    vehicle = make_vehicle()
    assert vehicle.now_s() == 0.0
    for deadline_s in (0.05, 0.31, 7.0, 3600.0):
        vehicle.wait_until(deadline_s)
        assert vehicle.now_s() == deadline_s
    vehicle.wait_until(10.0)
    assert vehicle.now_s() == 3600.0, "time never runs backwards"


def test_a_whole_flight():
    vehicle = make_vehicle()
    state = vehicle.state()
    assert (state.armed, state.landed) == (False, LandedState.ON_GROUND)
    assert state.system_status is SystemStatus.STANDBY
    np.testing.assert_allclose(state.position_ned_m, 0.0, atol=1e-9)

    assert ask(vehicle, RequestKind.ARM) is RequestState.CONFIRMED
    assert ask(vehicle, RequestKind.TAKEOFF, altitude_m=10.0) is RequestState.CONFIRMED
    assert vehicle.state().landed is LandedState.TAKING_OFF
    vehicle.wait_until(12.0)
    state = vehicle.state()
    assert state.mode is FlightMode.HOLD, "after the climb it holds"
    assert state.landed is LandedState.IN_AIR
    np.testing.assert_allclose(state.position_ned_m, [0.0, 0.0, -10.0], atol=0.3)

    vehicle.send_velocity(NORTH_NED)
    assert ask(vehicle, RequestKind.EXTERNAL) is RequestState.CONFIRMED
    stream(vehicle, NORTH_NED, 10.0)
    state = vehicle.state()
    np.testing.assert_allclose(state.velocity_ned_mps, NORTH_NED, atol=1e-6)
    np.testing.assert_allclose(state.position_ned_m[0], 19.0, atol=0.5)
    np.testing.assert_allclose(vehicle.position_enu_m, [5.0, 24.0, 10.0], atol=0.5)

    assert ask(vehicle, RequestKind.LAND) is RequestState.CONFIRMED
    assert vehicle.state().landed is LandedState.LANDING
    vehicle.wait_until(vehicle.now_s() + 20.0)
    state = vehicle.state()
    assert state.landed is LandedState.ON_GROUND
    assert not state.armed, "disarms itself after landing"
    assert vehicle.position_enu_m[2] == 0.0
    assert vehicle.contacts == 0


def test_without_setpoints_nothing_moves():
    vehicle = engaged()
    before = vehicle.position_enu_m
    vehicle.wait_until(0.5)
    np.testing.assert_allclose(vehicle.position_enu_m, before)


def test_setpoint_loss_is_a_failsafe_that_heals_by_itself():
    vehicle = engaged()
    stream(vehicle, NORTH_NED, 2.0)
    lost_s = vehicle.now_s() - 0.05
    vehicle.wait_until(lost_s + 1.0)
    assert vehicle.state().mode is FlightMode.EXTERNAL
    vehicle.wait_until(lost_s + 1.2)
    state = vehicle.state()
    assert state.mode is FlightMode.RETURN
    assert state.system_status is SystemStatus.CRITICAL
    (event,) = [e for e in vehicle.take_events() if e.kind is EventKind.STATUS_TEXT]
    assert event.severity is Severity.CRITICAL
    assert vehicle.take_events() == []

    stream(vehicle, NORTH_NED, 0.2)
    state = vehicle.state()
    assert state.mode is FlightMode.EXTERNAL
    assert state.system_status is SystemStatus.ACTIVE


def test_a_mode_chosen_during_the_failsafe_stays():
    vehicle = engaged(on_setpoint_loss=FlightMode.HOLD)
    vehicle.wait_until(3.0)
    assert vehicle.state().mode is FlightMode.HOLD
    assert vehicle.state().system_status is SystemStatus.CRITICAL
    vehicle.take_over(FlightMode.OTHER)
    stream(vehicle, NORTH_NED, 2.0)
    state = vehicle.state()
    assert (state.mode, state.mode_name) == (FlightMode.OTHER, "POSCTL")
    assert state.system_status is SystemStatus.ACTIVE


def test_the_pilot_takes_over_at_once():
    vehicle = engaged()
    stream(vehicle, NORTH_NED, 3.0)
    vehicle.take_over(FlightMode.HOLD)
    assert vehicle.state().mode is FlightMode.HOLD
    at = vehicle.position_enu_m
    stream(vehicle, NORTH_NED, 10.0)
    assert vehicle.state().mode is FlightMode.HOLD
    assert np.linalg.norm(vehicle.position_enu_m - at) < 2.0, "setpoints are ignored"


@pytest.mark.parametrize("kind", [RequestKind.EXTERNAL, RequestKind.TAKEOFF, RequestKind.ARM])
def test_what_px4_rejects(kind):
    vehicle = make_vehicle(airborne=kind is RequestKind.EXTERNAL)
    if kind is RequestKind.ARM:
        assert ask(vehicle, RequestKind.EXTERNAL) is RequestState.CONFIRMED, "disarmed it may"
        assert not vehicle.state().ready_to_arm
    assert ask(vehicle, kind) is RequestState.REJECTED
    assert "TEMPORARILY_REJECTED" in vehicle.request_status().detail


def test_requests_are_pending_until_the_next_wait():
    vehicle = make_vehicle()
    assert vehicle.request_status().state is RequestState.IDLE
    vehicle.request(RequestKind.ARM)
    assert vehicle.request_status().state is RequestState.PENDING


def test_it_takes_off_from_setpoints_in_external_mode():
    vehicle = make_vehicle()
    vehicle.send_velocity(np.zeros(3))
    ask(vehicle, RequestKind.EXTERNAL)
    vehicle.send_velocity(np.zeros(3))
    assert ask(vehicle, RequestKind.ARM) is RequestState.CONFIRMED
    stream(vehicle, np.array([0.0, 0.0, -1.0]), 5.0)
    assert vehicle.position_enu_m[2] == pytest.approx(4.5, abs=0.2)


def test_it_returns_and_lands_at_home():
    vehicle = engaged(start_enu_m=np.array([20.0, 20.0, 20.0]))
    stream(vehicle, np.array([4.0, 0.0, 0.0]), 12.0)
    ask(vehicle, RequestKind.RETURN)
    vehicle.wait_until(vehicle.now_s() + 180.0)
    assert not vehicle.state().armed
    np.testing.assert_allclose(vehicle.position_enu_m, [20.0, 20.0, 0.0], atol=0.8)


def test_it_lands_on_roofs():
    vehicle = make_vehicle(airborne=True, start_enu_m=np.array([50.0, 50.0, 45.0]))
    ask(vehicle, RequestKind.LAND)
    vehicle.wait_until(60.0)
    assert vehicle.position_enu_m[2] == pytest.approx(30.0)
    assert vehicle.state().landed is LandedState.ON_GROUND
    assert vehicle.contacts == 0


def test_the_referee_counts_each_contact_once():
    vehicle = engaged(start_enu_m=np.array([50.0, 20.0, 20.0]))
    stream(vehicle, np.array([5.0, 0.0, 0.0]), 14.0)
    assert vehicle.contacts == 1
    assert vehicle.min_clearance_m < -5.0
    stream(vehicle, np.array([-5.0, 0.0, 0.0]), 14.0)
    assert vehicle.contacts == 2
    assert vehicle.contacts == 2, "asking does not count"


def test_the_clearance_of_a_pass():
    vehicle = engaged(start_enu_m=np.array([36.5, 20.0, 20.0]))
    assert vehicle.min_clearance_m == pytest.approx(np.hypot(3.5, 20.0))
    stream(vehicle, np.array([5.0, 0.0, 0.0]), 12.0)
    assert vehicle.min_clearance_m == pytest.approx(3.5)
    assert vehicle.contacts == 0


def test_a_setpoint_changes_nothing_at_once_and_everything_after_the_lag():
    vehicle = engaged(lag=VelocityLag(time_constant_s=0.5, acceleration_max_mps2=100.0))
    stream(vehicle, NORTH_NED, 0.5)
    np.testing.assert_allclose(
        vehicle.state().velocity_ned_mps, NORTH_NED * (1.0 - np.exp(-1.0)), atol=1e-9
    )


def test_long_and_short_waits_fly_the_same_way():
    short, long = engaged(), engaged()
    long.send_velocity(NORTH_NED)
    long.wait_until(long.now_s() + 0.9)
    short.send_velocity(NORTH_NED)
    for _ in range(90):
        short.wait_until(short.now_s() + 0.01)
    np.testing.assert_allclose(short.position_enu_m, long.position_enu_m, atol=1e-9)


def test_wind_and_noise_come_from_the_generator():
    def fly(seed):
        vehicle = engaged(
            seed=seed,
            wind=Disturbance(std=0.5, correlation_s=3.0),
            position_noise=Disturbance(std=0.3, correlation_s=10.0),
        )
        stream(vehicle, NORTH_NED, 5.0)
        return vehicle

    one, same, other = fly(1), fly(1), fly(2)
    np.testing.assert_array_equal(one.state().position_ned_m, same.state().position_ned_m)
    assert not np.array_equal(one.state().position_ned_m, other.state().position_ned_m)
    tie = LocalTie.from_launch(np.array([5.0, 5.0, 0.0]), NOWHERE)
    error_m = tie.position_to_map(one.state().position_ned_m) - one.position_enu_m
    assert 0.0 < np.linalg.norm(error_m) < 1.5


@pytest.mark.parametrize(
    "velocity",
    [
        pytest.param(np.array([np.nan, 0.0, 0.0]), id="nan"),
        pytest.param(np.array([np.inf, 0.0, 0.0]), id="inf"),
        pytest.param(np.zeros(2), id="shape"),
    ],
)
def test_unusable_setpoints_are_refused(velocity):
    vehicle = make_vehicle()
    with pytest.raises(ValueError, match="finite"):
        vehicle.send_velocity(velocity)
    assert vehicle.stats().setpoints_sent == 0


def test_the_origin_of_a_map_on_earth():
    corner = GeoPoint(47.0, 8.0, 400.0)
    city = make_city(origin=corner)
    start = np.array([20.0, 30.0, 15.0])
    vehicle = make_vehicle(city, start_enu_m=start, airborne=True)
    state = vehicle.state()
    tie = LocalTie.from_origins(corner, state.origin)
    np.testing.assert_allclose(tie.position_to_map(state.position_ned_m), start, atol=1e-3)


def test_the_origin_of_a_map_without_a_place_on_earth():
    vehicle = make_vehicle(start_enu_m=np.array([20.0, 30.0, 15.0]), airborne=True)
    state = vehicle.state()
    assert state.origin == NOWHERE
    tie = LocalTie.from_launch(np.array([5.0, 5.0, 0.0]), state.origin)
    np.testing.assert_allclose(tie.position_to_map(state.position_ned_m), [20, 30, 15], atol=1e-9)


def test_a_start_is_needed_somewhere():
    with pytest.raises(ValueError, match="start_enu_m is needed"):
        make_vehicle(make_city(origin=GeoPoint(47.0, 8.0, 400.0)))


def test_targets_report_where_they_are():
    vertices = np.array([[[80.0, 10.0, 20.0], [80.0, 90.0, 20.0]]])
    path = TargetPaths.through(vertices, np.array([2.0]))
    vehicle = make_vehicle(targets={7: path})
    assert vehicle.targets()[7].time_s == 0.0
    vehicle.wait_until(10.04)
    report = vehicle.targets()[7]
    assert report.time_s == pytest.approx(10.0)
    np.testing.assert_allclose(report.velocity_ned_mps, [2.0, 0.0, 0.0])
    launch_to_target_m = geodetic_to_enu(NOWHERE, report.position)
    np.testing.assert_allclose(launch_to_target_m, [75.0, 25.0, 20.0], atol=0.01)


def test_the_books_of_what_was_sent():
    vehicle = engaged()
    stream(vehicle, NORTH_NED, 1.0)
    vehicle.send_heartbeat(SystemStatus.ACTIVE)
    vehicle.say("arrived", Severity.NOTICE)
    vehicle.close()
    assert vehicle.stats().setpoints_sent == 21
    assert [status for _, status in vehicle.heartbeats] == [SystemStatus.ACTIVE]
    assert [text for _, _, text in vehicle.said] == ["arrived"]
