"""What the vehicle over MAVLink makes of its telemetry: state, epochs, reboots, texts."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.vehicle import EventKind, FlightMode, LandedState, Severity, SystemStatus


def events(bench, kind=None):
    return [event for event in bench.vehicle.take_events() if kind in (None, event.kind)]


# -- state -------------------------------------------------------------------------------------


def test_there_is_no_state_until_heartbeat_position_and_attitude_came(bench):
    vehicle = bench.attach()
    assert vehicle.state() is None
    bench.position()
    bench.run()
    assert vehicle.state() is None
    bench.attitude()
    bench.run()
    assert vehicle.state() is not None


def test_a_snapshot_in_si_units(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.autopilot.heartbeat(0x00060000, armed=True, status=4)
    bench.run()
    state = vehicle.state()
    np.testing.assert_allclose(state.position_ned_m, (1.0, 2.0, -3.0))
    np.testing.assert_allclose(state.velocity_ned_mps, (0.5, 0.0, 0.0))
    np.testing.assert_allclose(state.attitude_rad, (0.1, 0.2, 0.3), rtol=1e-6)
    assert (state.mode, state.mode_name, state.armed) == (FlightMode.EXTERNAL, "OFFBOARD", True)
    assert (state.landed, state.system_status) == (LandedState.IN_AIR, SystemStatus.ACTIVE)
    assert state.origin.latitude_deg == pytest.approx(47.397742)
    assert state.origin.altitude_m == pytest.approx(489.4)
    assert state.position_valid
    assert state.battery_fraction is None


def test_a_snapshot_never_changes(bench):
    vehicle = bench.attach()
    bench.flying()
    before = vehicle.state()
    bench.position(x=9.0)
    bench.run()
    assert before.position_ned_m[0] == 1.0
    assert vehicle.state().position_ned_m[0] == 9.0
    for array in (before.position_ned_m, before.velocity_ned_mps, before.attitude_rad):
        assert not array.flags.writeable


@pytest.mark.parametrize("bad", [{"x": math.nan}, {"z": math.inf}, {"vx": -math.inf}])
def test_a_position_that_is_no_number_leaves_the_last_one_to_age(bench, bad):
    vehicle = bench.attach()
    bench.flying()
    before = vehicle.state()
    bench.run(1.0)
    bench.position(**bad)
    bench.run()
    assert vehicle.state().time_s == before.time_s
    assert np.isfinite(vehicle.state().position_ned_m).all()


def test_the_estimator_must_vouch_and_keep_vouching(bench):
    vehicle = bench.attach()
    bench.flying()
    assert vehicle.state().position_valid
    bench.run(4.9)
    assert vehicle.state().position_valid
    bench.run(0.2)
    assert not vehicle.state().position_valid
    bench.estimator(0x0065)
    bench.run()
    assert not vehicle.state().position_valid


def test_only_the_autopilot_of_the_vehicle_speaks_for_it(bench):
    vehicle = bench.attach()
    bench.flying()
    before = vehicle.state()
    for stranger in (bench.sender(1, 191), bench.sender(1, 2), bench.sender(2), bench.sender(255)):
        stranger.heartbeat(0x00060000, armed=True, status=5)
        stranger.send(dialect.MAVLink_local_position_ned_message(61_000, 99, 99, 99, 9, 9, 9))
        stranger.send(dialect.MAVLink_statustext_message(2, b"I am somebody else"))
    bench.run()
    after = vehicle.state()
    assert (after.mode, after.armed, after.time_s) == (before.mode, False, before.time_s)
    assert vehicle.stats().packets_foreign == 12
    assert events(bench) == []


def test_numbers_no_standard_knows(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.autopilot.heartbeat(status=200)
    bench.landed(77)
    bench.autopilot.send(dialect.MAVLink_statustext_message(200, b"odd"))
    bench.run()
    state = vehicle.state()
    assert (state.system_status, state.landed) == (SystemStatus.UNINIT, LandedState.UNKNOWN)
    assert [event.severity for event in events(bench)] == [Severity.DEBUG]


def sys_status(health, battery=-1):
    check = dialect.MAV_SYS_STATUS_PREARM_CHECK
    return dialect.MAVLink_sys_status_message(
        check, check, check if health else 0, 0, 0, 0, battery, 0, 0, 0, 0, 0, 0
    )


def test_ready_to_arm_and_battery(bench):
    vehicle = bench.attach()
    bench.flying()
    for healthy in (True, False, True):
        bench.autopilot.send(sys_status(healthy, battery=55))
        bench.run()
        assert vehicle.state().ready_to_arm is healthy
    assert vehicle.state().battery_fraction == 0.55


# -- epochs and reboots ------------------------------------------------------------------------


def odometry(reset_counter):
    zeros = (0.0,) * 21
    return dialect.MAVLink_odometry_message(
        0, 1, 1, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0, 0, 0, 0, zeros, zeros, reset_counter, 0, 0
    )


def test_an_estimator_reset_is_a_new_epoch(bench):
    vehicle = bench.attach()
    bench.flying()
    epochs = []
    for counter in (4, 4, 5, 5, 7, 255, 0):
        bench.autopilot.send(odometry(counter))
        bench.run(0.1)
        epochs.append(vehicle.state().frame_epoch)
    assert epochs == [0, 0, 1, 1, 2, 3, 4]


def test_a_flood_of_attitudes_is_looked_at_now_and_then(bench):
    """PX4 sends a hundred a second; what is decoded is never older than a tick of the loop."""
    vehicle = bench.attach()
    bench.flying()
    for step in range(100):
        bench.attitude(yaw=0.01 * step)
        bench.run(0.01)
        assert abs(vehicle.state().attitude_rad[2] - 0.01 * step) <= 0.05 or step < 5


def test_an_origin_that_moves_is_a_new_epoch(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.origin(latitude=473977424)  # 4 cm: rounding
    bench.run()
    assert vehicle.state().frame_epoch == 0
    bench.origin(latitude=473977520)
    bench.run()
    assert vehicle.state().frame_epoch == 1
    bench.origin(latitude=473977520, altitude=489900)
    bench.run()
    assert vehicle.state().frame_epoch == 2
    bench.origin(0, 0, 0)  # no place: ignored
    bench.run()
    assert vehicle.state().frame_epoch == 2
    assert vehicle.state().origin.altitude_m == pytest.approx(489.9)
    for step in range(1, 5):  # rounding does not add up unseen
        bench.origin(latitude=473977520 + 4 * step, altitude=489900)
    bench.run()
    assert vehicle.state().frame_epoch == 4


def test_a_reboot_drops_all_that_was_known(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.run(5.0)
    events(bench)
    asked = len(bench.commands(dialect.MAV_CMD_REQUEST_MESSAGE))
    bench.attitude(boot_ms=900)
    bench.run()
    (event,) = events(bench, EventKind.REBOOT)
    assert event.severity is Severity.CRITICAL
    assert vehicle.state() is None
    bench.autopilot.heartbeat()
    bench.position(boot_ms=1000)
    bench.run(0.1)
    state = vehicle.state()
    assert (state.origin, state.frame_epoch, state.position_valid) == (None, 1, False)
    assert len(bench.commands(dialect.MAV_CMD_REQUEST_MESSAGE)) > asked


@pytest.mark.parametrize(
    ("before_ms", "after_ms", "reboots"),
    [(60_000, 59_000, 0), (60_000, 58_999, 1), (2**32 - 20, 30, 0), (2**31, 0, 0), (5000, 4990, 0)],
)
def test_what_counts_as_a_reboot(bench, before_ms, after_ms, reboots):
    bench.attach()
    bench.position(boot_ms=before_ms)
    bench.run()
    bench.attitude(boot_ms=after_ms)
    bench.run()
    assert len(events(bench, EventKind.REBOOT)) == reboots


# -- texts -------------------------------------------------------------------------------------


def test_texts_are_joined_and_trimmed(bench):
    bench.attach()
    text = b"Arming denied: Resolve system health failures first\t"
    bench.autopilot.send(dialect.MAVLink_statustext_message(2, text[:50], 9, 0))
    bench.run()
    assert events(bench) == []
    bench.autopilot.send(dialect.MAVLink_statustext_message(2, text[50:], 9, 1))
    bench.autopilot.send(dialect.MAVLink_statustext_message(6, b"Takeoff detected\t"))
    bench.run()
    assert [(event.severity, event.text) for event in events(bench)] == [
        (Severity.CRITICAL, "Arming denied: Resolve system health failures first"),
        (Severity.INFO, "Takeoff detected"),
    ]


def test_a_text_whose_end_is_lost_is_shown_as_far_as_it_came(bench):
    bench.attach()
    bench.autopilot.send(dialect.MAVLink_statustext_message(2, b"a" * 50, 9, 0))
    bench.run()
    bench.autopilot.send(dialect.MAVLink_statustext_message(2, b"b" * 50, 10, 0))
    bench.run()
    assert [event.text for event in events(bench)] == ["a" * 50]
    bench.run(2.5)
    assert [event.text for event in events(bench)] == ["b" * 50]
