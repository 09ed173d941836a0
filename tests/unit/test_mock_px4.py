"""The rules of PX4 that a companion lives by but for OFFBOARD, each as one test."""

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings
from tests.unit.px4_bench import (
    ACCEPTED,
    ARM,
    DENIED,
    LAND,
    LOITER,
    NAN,
    OFFBOARD,
    POSCTL,
    REJECTED,
    REPOSITION,
    RTL,
    SET_MODE,
    TAKEOFF,
    UNSUPPORTED,
    altitude_m,
    booted,
    flying,
    gcs_heartbeat,
    mode,
    state,
    sticks,
)

HOME_ALTITUDE_M = 489.4


# -- disarmed ------------------------------------------------------------------------------


def test_p3_mode_change_while_disarmed_is_always_accepted():
    bench = booted()
    for params in (OFFBOARD, POSCTL, LOITER, (1.0, 4.0, 2.0), (1.0, 4.0, 4.0)):
        assert bench.command(SET_MODE, *params) == ACCEPTED


def test_p3_offboard_is_accepted_even_before_the_vehicle_is_ready():
    bench = Bench()
    bench.run(0.6)
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED
    bench.run(1.0)
    assert state(bench) == (0x01, 0x00060000, 0)


def test_p3_arming_in_offboard_without_a_stream_is_denied():
    bench = booted()
    bench.send(gcs_heartbeat())
    bench.command(SET_MODE, *OFFBOARD)
    assert bench.command(ARM, 1.0) == REJECTED
    bench.run(0.2)
    assert "Arming denied: Resolve system health failures first" in bench.texts()


def test_p3_arming_before_ready_is_denied():
    bench = Bench()
    bench.run(0.6)
    assert bench.command(ARM, 1.0) == REJECTED


def test_p2_one_recent_setpoint_is_enough_to_arm_in_offboard():
    bench = booted()
    bench.send(bench.velocity(0.0, 0.0, 0.0)())
    bench.command(SET_MODE, *OFFBOARD)
    assert bench.command(ARM, 1.0) == ACCEPTED


def test_p16_status_is_uninit_while_offboard_has_no_stream_and_standby_with_one():
    bench = booted()
    bench.command(SET_MODE, *OFFBOARD)
    bench.run(2.5)
    assert state(bench) == (0x01, 0x00060000, 0)
    assert not bench.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    bench.run(2.5, stream=bench.velocity(0.0, 0.0, 0.0))
    assert state(bench) == (0x11, 0x00060000, 3)
    assert bench.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000


def test_p16_heartbeat_bits_of_every_mode():
    bench = flying()
    bench.run(1.1, stream=bench.velocity(0.0, 0.0, 0.0))
    assert state(bench) == (0x91, 0x00060000, 4)
    expected = {LOITER: 0x03040000, (1.0, 4.0, 6.0): 0x06040000, (1.0, 4.0, 5.0): 0x05040000}
    for params, custom in expected.items():
        assert bench.command(SET_MODE, *params) == ACCEPTED
        bench.run(1.1)
        assert state(bench) == (0x9D, custom, 4)
    bench.run(0.5, stream=sticks())
    assert bench.command(SET_MODE, *POSCTL) == ACCEPTED
    bench.run(1.1, stream=sticks())
    assert state(bench) == (0xD1, 0x00030000, 4)


def test_p16_boot_goes_from_uninit_to_standby_when_ready():
    bench = Bench(Settings(place_vehicle(None, None), boot_s=4.6))
    bench.run(6.0)
    heartbeats = [(r.time_s, r.message) for r in bench.received if r.name == "HEARTBEAT"]
    assert {m.base_mode for _, m in heartbeats} == {0x1D}
    assert {m.custom_mode for _, m in heartbeats} == {0x03040000}
    assert [round(t, 1) for t, m in heartbeats if m.system_status == 0] == [1.6, 2.6, 3.6]
    assert [round(t, 1) for t, m in heartbeats if m.system_status == 3] == [4.6, 5.6]


# -- armed and on the ground ---------------------------------------------------------------


def test_p18_disarms_ten_seconds_after_spooling_up_without_take_off():
    bench = booted()
    still = bench.velocity(0.0, 0.0, 0.0)
    bench.run(0.2, stream=still)
    bench.command(SET_MODE, *OFFBOARD)
    bench.command(ARM, 1.0)
    armed_s = bench.time_s
    bench.run(10.5, stream=still)
    assert bench.vehicle.autopilot.armed
    bench.run(3.0, stream=still, until=lambda: not bench.vehicle.autopilot.armed)
    assert bench.time_s - armed_s == pytest.approx(11.0, abs=0.1)  # PX4's own clock: 11.02 s
    assert altitude_m(bench) == pytest.approx(0.0, abs=0.05)


def test_offboard_climb_rate_takes_off_by_itself():
    bench = booted()
    climb = bench.velocity(0.0, 0.0, -1.5)
    bench.run(0.2, stream=climb)
    bench.command(SET_MODE, *OFFBOARD)
    bench.command(ARM, 1.0)
    bench.run(8.0, stream=climb)
    assert altitude_m(bench) > 5.0
    assert bench.last("EXTENDED_SYS_STATE").landed_state == 2


def test_takeoff_altitude_is_amsl_and_ends_in_hold():
    bench = booted()
    assert bench.command(ARM, 1.0) == ACCEPTED
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, HOME_ALTITUDE_M + 12.0) == ACCEPTED
    bench.run(4.0)
    assert mode(bench) == 0x02040000
    assert bench.last("EXTENDED_SYS_STATE").landed_state == 3
    bench.run(12.0)
    assert mode(bench) == 0x03040000
    assert altitude_m(bench) == pytest.approx(12.0, abs=0.5)


def test_takeoff_without_altitude_climbs_mis_takeoff_alt():
    bench = booted()
    bench.command(ARM, 1.0)
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    bench.run(12.0)
    assert altitude_m(bench) == pytest.approx(2.5, abs=0.3)


def test_takeoff_while_disarmed_is_accepted_and_flies_once_armed():
    bench = booted()
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, HOME_ALTITUDE_M + 5.0) == ACCEPTED
    bench.run(3.0)
    assert mode(bench) == 0x02040000
    assert altitude_m(bench) == pytest.approx(0.0, abs=0.05)
    assert bench.command(ARM, 1.0) == ACCEPTED
    bench.run(12.0)
    assert altitude_m(bench) == pytest.approx(5.0, abs=0.3)


def test_velocity_stream_does_not_disturb_auto_takeoff():
    bench = booted()
    bench.command(ARM, 1.0)
    bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, HOME_ALTITUDE_M + 5.0)
    bench.run(12.0, stream=bench.velocity(3.0, 0.0, 0.0))
    assert altitude_m(bench) == pytest.approx(5.0, abs=0.3)
    assert abs(bench.last("LOCAL_POSITION_NED").x) < 0.1


# -- signs of life -------------------------------------------------------------------------


@pytest.mark.parametrize("system", [1, 255, 77])
def test_p15_a_heartbeat_of_type_gcs_counts_as_a_ground_station_whatever_its_system(system):
    bench = booted()
    bench.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), identity=(system, 191))
    bench.command(SET_MODE, 1.0, 99.0)
    assert bench.texts() == []
    bench.send(gcs_heartbeat(), identity=(system, 191))
    bench.command(SET_MODE, 1.0, 99.0)
    assert "Unsupported main mode" in bench.texts()


# -- offboard in the air -------------------------------------------------------------------


def test_only_ground_stations_are_told_why_a_mode_is_refused():
    bench = flying()
    bench.command(SET_MODE, *LOITER)
    bench.run(3.0)
    bench.send(gcs_heartbeat())
    bench.command(SET_MODE, *OFFBOARD)
    bench.run(0.3)
    assert "Switching to Offboard is currently not available" not in bench.texts()
    bench.command(SET_MODE, *OFFBOARD, identity=(255, 190))
    bench.run(0.3)
    assert "Switching to Offboard is currently not available" in bench.texts()


def test_braking_in_automatic_modes_follows_mpc_acc_hor():
    bench = flying()
    bench.run(6.0, stream=bench.velocity(8.0, -8.0, 0.0))
    assert bench.command(SET_MODE, *LOITER) == ACCEPTED
    bench.received.clear()
    bench.run(6.0)
    track = [(m.time_boot_ms / 1e3, m.vx, m.vy) for m in bench.all("LOCAL_POSITION_NED")]
    for (t0, x0, y0), (t1, x1, y1) in itertools.pairwise(track):
        assert math.hypot(x1 - x0, y1 - y0) <= 1.3 * 3.0 * (t1 - t0)


# -- going somewhere and coming down -------------------------------------------------------


@pytest.mark.parametrize("as_int", [True, False], ids=["COMMAND_INT", "COMMAND_LONG"])
def test_p17_reposition_with_change_mode_leaves_offboard(as_int):
    bench = flying()
    there = GeoPoint(47.397742 + 10.0 / 111_195.0, 8.545594, HOME_ALTITUDE_M + 10.0)
    if as_int:
        message = mavlink.MAVLink_command_int_message(
            1, 1, 0, REPOSITION, 0, 0, -1.0, 1.0, 0.0, NAN,
            round(there.latitude_deg * 1e7), round(there.longitude_deg * 1e7), there.altitude_m,
        )  # fmt: skip
        assert bench.ask(message, REPOSITION) == ACCEPTED
    else:
        place = (there.latitude_deg, there.longitude_deg, there.altitude_m)
        assert bench.command(REPOSITION, -1.0, 1.0, 0.0, NAN, *place) == ACCEPTED
    bench.run(20.0, stream=bench.velocity(0.0, 2.0, 0.0))
    assert mode(bench) == 0x03040000
    last = bench.last("LOCAL_POSITION_NED")
    # A float32 latitude is good to about 0.2 m only: that is why COMMAND_INT exists.
    assert (last.x, last.y) == pytest.approx((10.0, 0.0), abs=0.1 if as_int else 0.6)


def test_p17_reposition_without_change_mode_is_denied_outside_hold():
    bench = flying()
    params = (-1.0, 0.0, 0.0, NAN, NAN, NAN, NAN)
    assert bench.command(REPOSITION, *params) == DENIED
    bench.command(SET_MODE, *LOITER)
    assert bench.command(REPOSITION, *params) == ACCEPTED


def test_p18_land_disarms_two_seconds_after_landing_and_returns_to_the_last_wanted_mode():
    bench = flying()
    assert bench.command(LAND) == ACCEPTED
    bench.run(1.0)
    assert bench.last("EXTENDED_SYS_STATE").landed_state == 4
    assert bench.run(60.0, until=lambda: bench.vehicle.autopilot.landed)
    landed_s = bench.time_s
    assert bench.run(5.0, until=lambda: not bench.vehicle.autopilot.armed)
    assert bench.time_s - landed_s == pytest.approx(2.0, abs=0.1)
    bench.run(1.1)
    assert state(bench) == (0x11, 0x00060000, 0)  # OFFBOARD again, and not ready for lack of it


def test_land_is_allowed_whatever_happens():
    bench = flying()
    bench.vehicle.autopilot.estimator.gps_lost_at_s = -100.0
    assert bench.command(LAND) == ACCEPTED


def test_return_climbs_to_thirty_metres_first_and_lands_at_home():
    bench = flying()
    bench.run(15.0, stream=bench.velocity(2.0, 0.0, 0.0))
    assert bench.command(RTL) == ACCEPTED
    highest = 0.0
    while bench.vehicle.autopilot.armed and bench.time_s < 200.0:
        bench.run(1.0)
        highest = max(highest, altitude_m(bench))
    assert highest == pytest.approx(30.0, abs=0.8)
    last = bench.last("LOCAL_POSITION_NED")
    assert math.hypot(last.x, last.y) < 1.5


def test_return_close_to_home_only_descends():
    bench = flying()
    bench.command(RTL)
    bench.run(5.0)
    assert altitude_m(bench) < 10.3


def test_disarming_in_the_air_is_refused_and_forced_by_the_magic_number():
    bench = flying()
    assert bench.command(ARM, 0.0) == REJECTED
    assert bench.command(ARM, 0.0, 21196.0) == ACCEPTED
    bench.run(5.0)
    assert bench.last("LOCAL_POSITION_NED").z == pytest.approx(0.0, abs=0.01)


def test_p18_force_does_not_skip_the_checks_when_arming():
    bench = booted()
    bench.command(SET_MODE, *OFFBOARD)
    assert bench.command(ARM, 1.0, 21196.0) == REJECTED


def test_return_and_land_prevent_arming():
    bench = booted()
    bench.command(SET_MODE, 1.0, 4.0, 5.0)
    assert bench.command(ARM, 1.0) == REJECTED


def test_mode_changes_show_only_in_the_next_heartbeat():
    bench = flying()
    heartbeats = len(bench.all("HEARTBEAT"))
    bench.run(
        1.5, stream=bench.velocity(0, 0, 0), until=lambda: len(bench.all("HEARTBEAT")) > heartbeats
    )
    assert bench.command(SET_MODE, *LOITER) == ACCEPTED
    bench.run(0.8)
    assert mode(bench) == 0x00060000
    bench.run(0.3)
    assert mode(bench) == 0x03040000


def test_gps_can_be_failed_by_command_and_comes_back():
    bench = flying()
    assert bench.command(420, 4.0, 1.0) == ACCEPTED
    bench.run(7.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert mode(bench) == 0x06040000
    assert bench.last("ESTIMATOR_STATUS").flags == 0x65
    assert bench.command(420, 4.0, 0.0) == ACCEPTED
    bench.run(1.5)
    assert bench.last("ESTIMATOR_STATUS").flags == 0x37F
    assert bench.command(420, 1.0, 1.0) == UNSUPPORTED
