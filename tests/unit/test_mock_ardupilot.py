"""ArduCopter's modes, arming, flights and failsafes, each rule as one test (A10 to A16)."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.ardupilot.modes import find_mode
from tests.unit.copter_bench import (
    ACCEPTED,
    ARM,
    AUTO,
    BRAKE,
    DENIED,
    FAILED,
    GUIDED,
    LAND,
    LAND_NOW,
    LOITER,
    REPOSITION,
    RTL,
    RTL_NOW,
    SET_MODE,
    STABILIZE,
    TAKEOFF,
    armed,
    autopilot,
    booted,
    copter,
    flying,
    landed_state,
    mode,
    position,
    state,
    steady,
)


def reposition(north_m, flags=0.0, frame=3, altitude=15.0):
    latitude = round((-35.3632610 + north_m / 111_318.845) * 1e7)
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, REPOSITION, 0, 0, 0, flags, 0, 0, latitude, 1491652299, altitude
    )


# -- A10 to A12: sequence, refusals --------------------------------------------------------


def test_a10_guided_arm_take_off():
    bench = armed()
    took_off_s = bench.time_s
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == ACCEPTED
    assert landed_state(bench) == 1
    assert bench.run(20.0, until=lambda: landed_state(bench) == 3)
    assert bench.run(20.0, until=lambda: position(bench)[2] < -9.5)
    assert bench.time_s - took_off_s == pytest.approx(8.9, abs=0.6)  # recorded
    assert bench.run(5.0, until=lambda: landed_state(bench) == 2)
    bench.run(2.0)
    assert position(bench)[2] == pytest.approx(-10.0, abs=0.1)


def test_a10_refusals_of_take_off():
    bench = booted()
    mode(bench, GUIDED)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == FAILED  # disarmed
    bench.command(ARM, 1.0)
    for frame, result in ((0, DENIED), (3, ACCEPTED)):
        message = mavlink.MAVLink_command_int_message(
            1, 1, frame, TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0, 10.0
        )
        assert bench.ask(message, TAKEOFF) == result
    bench.run(8.0)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 20.0) == FAILED  # in the air


def test_a10_arming_before_it_has_booted_fails_with_the_measured_text():
    bench = copter(boot_s=41.6)
    bench.run(1.5)
    assert bench.command(ARM, 1.0) == FAILED
    bench.run(0.1)
    assert bench.texts() == ["Arm: System not initialised"]


@pytest.mark.parametrize(("at_s", "number"), [(10.0, STABILIZE), (30.0, GUIDED)])
def test_a10_arming_before_position_and_checks_fails(at_s, number):
    bench = copter(boot_s=41.6)
    bench.run(at_s)
    assert mode(bench, number) == ACCEPTED
    assert bench.command(ARM, 1.0) == FAILED
    bench.run(0.1)
    assert bench.texts()[-1].startswith("Arm: ")


def test_a11_modes_change_at_any_time_while_disarmed():
    bench = copter(boot_s=41.6)
    bench.run(1.2)
    for number in (GUIDED, LOITER, LAND, BRAKE, RTL, STABILIZE):
        assert mode(bench, number) == ACCEPTED
        assert state(bench) == (0x59, number, 1)


def test_a11_refused_modes_and_their_reasons():
    bench = flying()
    assert mode(bench, 99) == FAILED
    assert bench.command(SET_MODE, 0.0, GUIDED) == DENIED  # no CUSTOM bit
    assert mode(bench, AUTO) == FAILED
    autopilot(bench).parameters.override("FLTMODE_GCSBLOCK", 1 << 5)
    assert mode(bench, LOITER) == FAILED
    autopilot(bench).estimator.gps_lost_at_s = bench.time_s - 7.5
    assert mode(bench, BRAKE) == FAILED
    bench.run(0.1)
    assert [text for text in bench.texts() if text.startswith(("Mode", "No such"))] == [
        "No such mode 99",
        "Mode change to AUTO failed: init failed",
        "Mode change to LOITER failed: GCS entry disabled (FLTMODE_GCSBLOCK)",
        "Mode change to BRAKE failed: requires position",
    ]


def test_a11_set_mode_is_obeyed_and_never_answered():
    bench = booted()
    assert bench.ask(mavlink.MAVLink_set_mode_message(1, 1, GUIDED), SET_MODE) is None
    assert state(bench)[1] == GUIDED


@pytest.mark.parametrize("number", [RTL, LAND, BRAKE, AUTO])
def test_a12_some_modes_are_not_armable(number):
    bench = booted()
    mode(bench, number)
    assert bench.command(ARM, 1.0) == FAILED
    bench.run(0.1)
    assert bench.texts()[-1] == f"Arm: {find_mode(number).name} mode not armable"
    health = bench.last("SYS_STATUS").onboard_control_sensors_health
    assert health & mavlink.MAV_SYS_STATUS_PREARM_CHECK  # measured on the ground in LAND


# -- A13 to A17: links with a pilot and a ground station -----------------------------------


def test_a15_reposition():
    bench = flying()
    assert bench.ask(reposition(20.0), REPOSITION) == ACCEPTED
    bench.run(15.0)
    assert position(bench) == pytest.approx((20.0, 0.0, -15.0), abs=0.3)
    mode(bench, LOITER)
    assert bench.ask(reposition(0.0), REPOSITION) == DENIED
    assert bench.ask(reposition(0.0, frame=1), REPOSITION) == DENIED
    assert bench.ask(reposition(0.0, flags=1.0), REPOSITION) == ACCEPTED
    assert state(bench)[1] == GUIDED


def test_a16_commands_that_are_modes():
    bench = flying()
    for command, number in ((17, LOITER), (RTL_NOW, RTL), (LAND_NOW, LAND)):
        assert bench.command(command) == ACCEPTED
        assert state(bench)[1] == number


# -- the rest of what was measured ---------------------------------------------------------


def test_disarming_in_the_air_fails_and_landing_disarms():
    bench = flying()
    assert bench.command(ARM, 0.0) == FAILED
    mode(bench, LAND)
    assert bench.run(1.0, until=lambda: landed_state(bench) == 4)
    assert bench.run(40.0, until=lambda: position(bench)[2] > -0.02)
    touched_s = bench.time_s
    assert bench.run(5.0, until=lambda: not autopilot(bench).armed)
    assert bench.time_s - touched_s == pytest.approx(2.1, abs=0.2)  # measured
    bench.run(1.1)
    assert state(bench) == (0x59, LAND, 3)
    assert landed_state(bench) == 1


def test_disarming_by_force_lets_it_fall():
    bench = flying()
    assert bench.command(ARM, 0.0, 21196.0) == ACCEPTED
    bench.run(3.0)
    assert position(bench)[2] == pytest.approx(0.0, abs=0.05)


def test_return_climbs_waits_lands_at_home_and_disarms():
    bench = steady(flying(), 4.0, 0.0, 0.0, duration_s=6.0)
    assert bench.command(RTL_NOW) == ACCEPTED
    bench.run(10.0)
    assert position(bench)[2] == pytest.approx(-15.0, abs=0.3)  # RTL_ALT
    assert bench.run(90.0, until=lambda: not autopilot(bench).armed)
    assert math.hypot(*position(bench)[:2]) < 0.5


def test_low_battery_acts_only_if_told_to():
    bench = flying(faults=["from=offboard,t=1,kind=battery_low,level=0.1"])
    steady(bench, 1.0, 0.0, 0.0)
    assert bench.last("SYS_STATUS").battery_remaining == 10
    assert state(bench)[1] == GUIDED
    autopilot(bench).parameters.override("BATT_LOW_MAH", 500.0)
    autopilot(bench).parameters.override("BATT_FS_LOW_ACT", 1)
    steady(bench, 1.0, 0.0, 0.0, duration_s=2.0)
    assert state(bench)[1:] == (LAND, 5)


# -- a transmitter by RC_CHANNELS_OVERRIDE ------------------------------------------------


def test_a_failsafe_that_lands_waits_four_seconds():
    bench = flying()
    autopilot(bench).parameters.override("SIM_GPS_DISABLE", 1)
    assert bench.run(12.0, until=lambda: state(bench)[1] == LAND)
    height_m = -autopilot(bench).body.position_m[2]
    bench.run(3.8)
    assert -autopilot(bench).body.position_m[2] == pytest.approx(height_m, abs=0.1)
    bench.run(3.0)
    assert -autopilot(bench).body.position_m[2] < height_m - 0.8
    bench.run(9.0)
    assert "EKF3 IMU0 stopped aiding" in bench.texts()
    autopilot(bench).parameters.override("SIM_GPS_DISABLE", 0)
    bench.run(0.5)
    assert "EKF3 IMU0 is using GPS" in bench.texts()[-3:]
