"""The rules of ArduCopter that a companion lives by, each as one test on a virtual clock."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.ardupilot.modes import find_mode
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM, TAKEOFF, LAND_NOW, RTL_NOW, REPOSITION, INTERVAL, REQUEST = (
    176, 400, 22, 21, 20, 192, 511, 512,
)  # fmt: skip
STABILIZE, AUTO, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 3, 4, 5, 6, 9, 17
ALL, POSITION_STREAM = 0, 6
VELOCITY = 0xDC7
NAN = math.nan


def copter(boot_s=1.5, **options):
    settings = {key: options.pop(key) for key in ("radio",) if key in options}
    place = place_vehicle(None, None, ARDUPILOT)
    return Bench(Settings(place, boot_s=boot_s, personality=ARDUPILOT, **settings), **options)


def booted(**options):
    """One that is ready, with the messages asked for that the tests look at."""
    bench = copter(**options)
    for name, rate_hz in (
        ("LOCAL_POSITION_NED", 20.0),
        ("ATTITUDE", 20.0),
        ("EKF_STATUS_REPORT", 10.0),
        ("EXTENDED_SYS_STATE", 10.0),
        ("SYS_STATUS", 5.0),
        ("POSITION_TARGET_LOCAL_NED", 5.0),
    ):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        assert bench.command(INTERVAL, number, 1e6 / rate_hz) == ACCEPTED
    bench.run(2.0)
    return bench


def mode(bench, number):
    return bench.command(SET_MODE, 1.0, number)


def armed(**options):
    bench = booted(**options)
    assert mode(bench, GUIDED) == ACCEPTED
    assert bench.command(ARM, 1.0) == ACCEPTED
    return bench


def flying(altitude=10.0, **options):
    """One in GUIDED, taken off and steady."""
    bench = armed(**options)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, altitude) == ACCEPTED
    assert bench.run(30.0, until=lambda: landed_state(bench) == 2)
    bench.run(2.0)
    return bench


def steady(bench, *velocity, duration_s=4.0, **options):
    """Fly a velocity until it is reached."""
    bench.run(duration_s, stream=bench.velocity(*velocity), **options)
    return bench


def position(bench):
    last = bench.last("LOCAL_POSITION_NED")
    return last.x, last.y, last.z


def speed(bench):
    last = bench.last("LOCAL_POSITION_NED")
    return last.vx, last.vy, last.vz


def landed_state(bench):
    return bench.last("EXTENDED_SYS_STATE").landed_state


def state(bench):
    heartbeat = bench.last("HEARTBEAT")
    return heartbeat.base_mode, heartbeat.custom_mode, heartbeat.system_status


def autopilot(bench):
    return bench.vehicle.autopilot


def gcs_heartbeat():
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def streams(bench, since_s):
    return {r.name for r in bench.received if r.time_s > since_s} - {"HEARTBEAT", "STATUSTEXT"}


# -- A1 to A5: setpoints -------------------------------------------------------------------


@pytest.mark.parametrize("other", [LOITER, BRAKE])
def test_a1_setpoints_outside_guided_are_dropped_without_a_word(other):
    bench = flying()
    assert mode(bench, other) == ACCEPTED
    before, texts = position(bench), bench.texts()
    steady(bench, 3.0, 0.0, 0.0)
    assert math.dist(position(bench), before) < 0.3
    assert bench.texts() == texts
    assert bench.vehicle.report()["setpoints_outside_offboard"] == 80


@pytest.mark.parametrize(
    ("frame", "heading", "flown"),
    [
        (1, 0.0, (2.0, 0.0, 0.0)),
        (7, 1.57, (2.0, 0.0, 0.0)),
        (8, 1.57, (0.0, 2.0, 0.0)),
        (9, 1.57, (0.0, 2.0, 0.0)),
    ],
    ids=["LOCAL_NED", "LOCAL_OFFSET_NED", "BODY_NED", "BODY_OFFSET_NED"],
)
def test_a2_four_frames_are_flown(frame, heading, flown):
    bench = flying()
    autopilot(bench).body.yaw_rad = heading
    stream = bench.setpoint(velocity=(2.0, 0.0, 0.0), type_mask=0x5C7, frame=frame)  # yaw rate 0
    bench.run(4.0, stream=stream)
    assert speed(bench) == pytest.approx(flown, abs=0.1)


@pytest.mark.parametrize("frame", [0, 3, 12, 20])
def test_a2_any_other_frame_stops(frame):
    bench = steady(flying(), 2.0, 0.0, 0.0)
    texts = bench.texts()
    bench.run(4.0, stream=bench.setpoint(velocity=(2.0, 0.0, 0.0), type_mask=VELOCITY, frame=frame))
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
    assert state(bench)[1] == GUIDED
    assert bench.texts() == texts


@pytest.mark.parametrize(
    "mask", [0xDE7, 0xDCF, 0xFFF, 0xC38], ids=["no vz", "no vx", "nothing", "position and push"]
)
def test_a3_a_partly_ignored_group_is_ignored_and_stops(mask):
    bench = steady(flying(), 2.0, 0.0, 0.0)
    bench.run(4.0, stream=bench.setpoint(velocity=(2.0, 0.0, 0.0), type_mask=mask))
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
    assert bench.vehicle.report()["setpoints_refused"] == 80


@pytest.mark.parametrize(
    ("velocity", "mask"),
    [
        ((NAN, 0.0, 0.0), VELOCITY),
        ((0.0, math.inf, 0.0), VELOCITY),
        ((1001.0, 0.0, 0.0), VELOCITY),
        ((2.0, 0.0, 0.0), 0xE07),
    ],
    ids=["nan", "infinite", "above 1000", "force"],
)
def test_a4_insane_values_stop(velocity, mask):
    bench = steady(flying(), 2.0, 0.0, 0.0)
    bench.run(4.0, stream=bench.setpoint(velocity=velocity, type_mask=mask))
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


@pytest.mark.parametrize(("frame", "expected"), [(1, 1.0), (8, 1.5)], ids=["absolute", "relative"])
def test_a5_yaw_is_relative_in_body_frames(frame, expected):
    bench = flying()
    autopilot(bench).body.yaw_rad = 0.5
    once = bench.setpoint(velocity=(0.0, 0.0, 0.0), type_mask=0x9C7, yaw=1.0, frame=frame)
    bench.send(once())
    bench.run(2.5)
    assert bench.last("ATTITUDE").yaw == pytest.approx(expected, abs=0.05)


# -- A6 to A9: time-out, fence, ground -----------------------------------------------------


def test_a6_after_three_seconds_of_silence_it_brakes_and_stays_in_guided():
    bench = steady(flying(), 3.0, 0.0, 0.0, duration_s=6.0)
    texts, acks = bench.texts(), len(bench.all("COMMAND_ACK"))
    silent_s, start = bench.time_s, position(bench)[0]
    bench.run(2.9)
    assert speed(bench)[0] == pytest.approx(3.0, abs=0.05)
    assert bench.run(2.0, until=lambda: speed(bench)[0] < 2.8)
    assert bench.time_s - silent_s == pytest.approx(3.2, abs=0.2)
    bench.run(3.0)
    assert position(bench)[0] - start == pytest.approx(12.1, rel=0.2)  # measured
    assert state(bench) == (0xD9, GUIDED, 4)
    assert bench.texts() == texts
    assert len(bench.all("COMMAND_ACK")) == acks


def test_a6_guid_timeout_is_a_parameter_with_a_floor():
    bench = steady(flying(), 2.0, 0.0, 0.0)
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 0.0, 9))
    bench.run(0.05, stream=bench.velocity(2.0, 0.0, 0.0))
    bench.run(2.5)
    assert speed(bench)[0] == pytest.approx(0.0, abs=0.1)


def test_a6_position_targets_never_time_out():
    bench = flying()
    bench.send(bench.position(12.0, -5.0, -12.0)())
    bench.run(15.0)
    assert position(bench) == pytest.approx((12.0, -5.0, -12.0), abs=0.2)


def test_a7_a_dead_companion_leaves_it_hovering_and_resuming_is_just_sending():
    bench = steady(flying(), 2.0, 0.0, 0.0)
    bench.run(30.0)
    assert state(bench) == (0xD9, GUIDED, 4)
    steady(bench, 0.0, 1.5, 0.0)
    assert speed(bench) == pytest.approx((0.0, 1.5, 0.0), abs=0.1)


def test_a8_the_fence_slows_velocity_setpoints_before_it():
    bench = flying(faults=["kind=geofence,radius=20"])
    steady(bench, 5.0, 0.0, 0.0, duration_s=20.0)
    assert 15.0 < position(bench)[0] < 18.5
    assert state(bench)[1] == GUIDED


def test_a8_without_avoidance_the_fence_is_breached_and_it_returns():
    bench = flying(faults=["kind=geofence,radius=20"])
    autopilot(bench).parameters.override("AVOID_ENABLE", 0)
    steady(bench, 5.0, 0.0, 0.0, duration_s=6.0)
    assert state(bench)[1] == RTL
    assert "Fence breached" in bench.texts()


def test_a9_velocity_never_takes_off_and_it_disarms_after_ten_seconds():
    bench = armed()
    armed_s = bench.time_s
    climb = bench.velocity(0.0, 0.0, -1.0)
    assert bench.run(15.0, stream=climb, until=lambda: not autopilot(bench).armed)
    assert bench.time_s - armed_s == pytest.approx(10.0, abs=0.3)
    assert position(bench)[2] == pytest.approx(0.0, abs=0.05)
    bench.run(0.1)
    assert bench.texts()[-1] == "Disarming motors"


def test_a9_a_velocity_stream_kills_the_take_off_that_was_accepted():
    bench = armed()
    stream = bench.velocity(0.0, 0.0, 0.0)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == ACCEPTED
    assert bench.run(15.0, stream=stream, until=lambda: not autopilot(bench).armed)
    assert position(bench)[2] == pytest.approx(0.0, abs=0.05)


def test_a9_a_velocity_stream_stops_a_climb():
    bench = armed()
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0)
    assert bench.run(10.0, until=lambda: position(bench)[2] < -2.0)
    steady(bench, 0.0, 0.0, 0.0, duration_s=5.0)
    assert position(bench)[2] == pytest.approx(-3.6, rel=0.2)  # measured
    assert speed(bench)[2] == pytest.approx(0.0, abs=0.05)


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


# -- A13 to A17: links with a pilot and a ground station -----------------------------------


def test_a13_the_yaw_stick_turns_the_nose_and_the_others_do_nothing():
    bench = flying(radio=True)
    message = mavlink.MAVLink_manual_control_message(1, 900, -900, 500, 500, 0)
    bench.send(message, identity=(255, 190))
    bench.run(1.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert bench.last("ATTITUDE").yaw == pytest.approx(1.0, abs=0.2)
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    autopilot(bench).parameters.override("GUID_OPTIONS", 4)
    before = bench.last("ATTITUDE").yaw
    bench.run(1.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert bench.last("ATTITUDE").yaw == pytest.approx(before, abs=0.05)


def test_a14_the_ground_stations_silence_returns_it_only_if_enabled():
    bench = flying()
    bench.send(gcs_heartbeat(), identity=(255, 190))
    steady(bench, 0.5, 0.0, 0.0, duration_s=8.0)
    assert state(bench)[1] == GUIDED
    autopilot(bench).parameters.override("FS_GCS_ENABLE", 1)
    bench.send(gcs_heartbeat(), identity=(255, 190))
    heard_s = bench.time_s
    stream = bench.velocity(0.5, 0.0, 0.0)
    assert bench.run(8.0, stream=stream, until=lambda: state(bench)[1] == RTL)
    assert bench.time_s - heard_s == pytest.approx(5.1, abs=0.1)  # measured
    assert state(bench) == (0xD9, RTL, 5)
    bench.send(gcs_heartbeat(), identity=(255, 190))
    bench.run(1.1)
    assert state(bench) == (0xD9, RTL, 4)
    assert [text for text in bench.texts() if "GCS" in text] == [
        "GCS Failsafe",
        "GCS Failsafe Cleared",
    ]


def test_a14_only_sysid_mygcs_counts_and_a_companion_is_never_missed():
    bench = flying()
    autopilot(bench).parameters.override("FS_GCS_ENABLE", 1)
    for identity in ((1, 191), (254, 190)):
        bench.send(gcs_heartbeat(), identity=identity)
    bench.run(10.0)
    assert state(bench)[1] == GUIDED


def reposition(north_m, flags=0.0, frame=3, altitude=15.0):
    latitude = round((-35.3632610 + north_m / 111_318.845) * 1e7)
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, REPOSITION, 0, 0, 0, flags, 0, 0, latitude, 1491652299, altitude
    )


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


def test_a17_brake_stops_where_it_measured_and_ignores_the_stream():
    bench = steady(flying(), 2.0, 0.0, 0.0)
    start = position(bench)[0]
    assert mode(bench, BRAKE) == ACCEPTED
    steady(bench, 2.0, 0.0, 0.0, duration_s=6.0)
    assert position(bench)[0] - start == pytest.approx(3.1, rel=0.2)
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


def test_a17_loiter_reads_the_pilots_throttle():
    bench = flying(radio=True)
    mode(bench, LOITER)
    low = mavlink.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0)
    bench.send(low, identity=(255, 190))
    bench.run(3.0)
    assert speed(bench)[2] > 1.0


# -- A18 to A21: what is sent --------------------------------------------------------------


def test_a18_local_position_comes_only_when_the_estimator_uses_gps():
    bench = copter(boot_s=41.6)
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, ALL, 4, 1))
    bench.run(41.0)
    assert bench.all("LOCAL_POSITION_NED") == []
    early = [m for m in bench.all("GLOBAL_POSITION_INT") if m.time_boot_ms < 9700]
    assert {(m.lat, m.lon, m.alt) for m in early} == {(0, 0, 0)}
    assert len(early) > 20
    assert bench.last("GLOBAL_POSITION_INT").lat == -353632610
    bench.run(1.5)
    assert bench.all("LOCAL_POSITION_NED")


def test_a18_the_origin_is_sent_when_set_and_when_armed_and_never_moves():
    bench = flying()
    steady(bench, 3.0, 0.0, 0.0)
    origins = {(m.latitude, m.longitude, m.altitude) for m in bench.all("GPS_GLOBAL_ORIGIN")}
    assert origins == {(-353632610, 1491652299, 584090)}
    assert len(bench.all("GPS_GLOBAL_ORIGIN")) == len(bench.all("HOME_POSITION")) == 2


def test_a18_local_and_global_position_agree_in_ardupilots_way():
    bench = flying()
    bench.command(INTERVAL, 33.0, 50_000.0)
    bench.send(bench.position(80.0, -60.0, -20.0)())
    bench.run(30.0)
    local, world = bench.last("LOCAL_POSITION_NED"), bench.last("GLOBAL_POSITION_INT")
    origin = bench.last("GPS_GLOBAL_ORIGIN")
    scale = 0.011131884502145034
    north = (world.lat - origin.latitude) * scale
    mean = math.radians((world.lat + origin.latitude) / 2e7)
    east = (world.lon - origin.longitude) * scale * math.cos(mean)
    assert (north, east) == pytest.approx((local.x, local.y), abs=0.02)
    assert world.relative_alt == pytest.approx(-local.z * 1e3, abs=20)


def test_a19_heartbeats_of_a_flight():
    bench = copter(boot_s=41.6)
    bench.run(2.0)
    assert state(bench) == (0x59, STABILIZE, 1)
    bench.run(42.0)
    assert state(bench) == (0x51, STABILIZE, 3)
    mode(bench, GUIDED)
    assert state(bench) == (0x59, GUIDED, 3)
    bench.command(ARM, 1.0)
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0)
    bench.run(1.0)
    assert state(bench) == (0xD9, GUIDED, 3)
    bench.run(5.0)
    assert state(bench) == (0xD9, GUIDED, 4)
    mode(bench, STABILIZE)
    bench.run(1.1)
    assert state(bench) == (0xD1, STABILIZE, 4)


def test_a19_a_mode_change_is_shown_at_once_and_arming_in_the_next_heartbeat():
    bench = booted()
    bench.run(1.5 - (bench.time_s % 1.0))  # well between two
    before = len(bench.all("HEARTBEAT"))
    mode(bench, GUIDED)
    assert len(bench.all("HEARTBEAT")) == before + 1
    bench.command(ARM, 1.0)
    assert state(bench)[0] == 0x59
    assert len(bench.all("HEARTBEAT")) == before + 1
    bench.run(1.1)
    assert state(bench)[0] == 0xD9


def test_a20_flags_of_the_boot():
    bench = copter(boot_s=41.6)
    bench.command(INTERVAL, 193.0, 100_000.0)
    bench.run(43.0)
    flags = []
    for message in bench.all("EKF_STATUS_REPORT"):
        if not flags or flags[-1] != message.flags:
            flags.append(message.flags)
    assert flags == [0x400, 0x000, 0x0A7, 0x33F]


def test_a20_gps_loss_lands_with_the_measured_flags_texts_and_delays():
    bench = flying()
    steady(bench, 0.5, 0.0, 0.0)
    lost_s = bench.time_s
    autopilot(bench).estimator.gps_lost_at_s = autopilot(bench).now_s
    stream = bench.velocity(0.5, 0.0, 0.0)
    ekf = lambda: bench.last("EKF_STATUS_REPORT").flags  # noqa: E731
    assert bench.run(10.0, stream=stream, until=lambda: ekf() == 0x025)
    assert bench.time_s - lost_s == pytest.approx(7.2, abs=0.2)
    assert bench.run(3.0, stream=stream, until=lambda: state(bench)[1] == LAND)
    assert bench.time_s - lost_s == pytest.approx(8.1, abs=0.2)
    assert state(bench)[2] == 5
    bench.run(1.3)
    assert state(bench) == (0xD1, LAND, 5)
    assert bench.texts()[-2:] == ["EKF variance", "EKF Failsafe: changed to LAND Mode"]
    assert mode(bench, GUIDED) == FAILED
    bench.run(8.0)
    assert ekf() == 0x0A7
    count = len(bench.all("LOCAL_POSITION_NED"))
    bench.run(2.0)
    assert len(bench.all("LOCAL_POSITION_NED")) == count


def test_a21_nothing_but_heartbeat_and_texts_is_sent_unasked():
    bench = copter()
    bench.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    bench.run(9.0)
    assert streams(bench, 2.0) == set()
    assert len(bench.all("HEARTBEAT")) == 9


def test_a21_request_data_stream_gives_the_streams_members_and_no_others():
    bench = copter()
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, POSITION_STREAM, 4, 1))
    bench.run(4.0)
    assert streams(bench, 3.0) == {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"}
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, ALL, 4, 1))
    bench.run(4.0)
    names = streams(bench, 4.0)
    assert len(names) == 28 - 1  # POSITION_TARGET_GLOBAL_INT comes in RTL only
    assert not names & {"EXTENDED_SYS_STATE", "POSITION_TARGET_LOCAL_NED", "HOME_POSITION"}
    counts = [len(bench.all(name, since_s=4.0)) for name in names]
    assert min(counts) >= 15
    assert max(counts) <= 18
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, ALL, 0, 0))
    bench.run(2.0)
    assert streams(bench, bench.time_s - 1.9) <= {"TIMESYNC"}


def test_a21_intervals_are_obeyed_and_a_stream_request_overrides_them():
    bench = copter()
    bench.run(2.0)
    assert bench.command(INTERVAL, 32.0, 100_000.0) == ACCEPTED
    bench.run(5.0)
    assert len(bench.all("LOCAL_POSITION_NED", since_s=bench.time_s - 4.0)) == 40
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, POSITION_STREAM, 2, 1))
    bench.run(5.0)
    assert len(bench.all("LOCAL_POSITION_NED", since_s=bench.time_s - 3.9)) == 8
    assert bench.command(INTERVAL, 32.0, -1.0) == ACCEPTED
    bench.run(2.0)
    assert bench.all("LOCAL_POSITION_NED", since_s=bench.time_s - 1.5) == []
    assert bench.command(INTERVAL, 9999.0, 1e5) == DENIED
    assert bench.command(INTERVAL, 436.0, 1e5) == DENIED


# -- the rest of what was measured ---------------------------------------------------------


def test_the_version_comes_after_the_acknowledgement():
    bench = copter()
    bench.run(0.5)
    assert bench.command(REQUEST, 148.0) == ACCEPTED
    assert [r.name for r in bench.received][-2:] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    version = bench.last("AUTOPILOT_VERSION")
    assert (version.capabilities, version.flight_sw_version) == (0xFBEF, 0x040603FF)
    assert bytes(version.flight_custom_version) == b"92b0cd78"


def test_addresses_component_200_is_answered_and_another_system_is_not():
    bench = booted()
    assert bench.command(SET_MODE, 1.0, GUIDED, component=200) == ACCEPTED
    assert bench.command(SET_MODE, 1.0, LOITER, system=2) is None
    assert bench.command(31999) == UNSUPPORTED


def test_a_component_heard_on_another_link_gets_its_own_messages():
    bench = booted(ground_links=(False, False))
    bench.send(gcs_heartbeat(), identity=(1, 200), link=1)
    assert bench.command(SET_MODE, 1.0, GUIDED, component=200) is None
    assert bench.all("COMMAND_LONG", link=1)


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


def test_the_nose_turns_into_the_direction_of_travel_when_yaw_is_free():
    bench = steady(flying(), 0.0, -1.5, 0.0, duration_s=3.0)
    assert bench.last("ATTITUDE").yaw == pytest.approx(-1.57, abs=0.1)


def test_velocity_response_is_the_measured_one_and_clipped_at_wpnav_speed():
    bench = flying()
    steady(bench, 2.0, 0.0, 0.0, duration_s=1.5)
    assert speed(bench)[0] == pytest.approx(1.85, abs=0.1)
    steady(bench, 50.0, 0.0, 0.0, duration_s=15.0)
    assert speed(bench)[0] == pytest.approx(10.0, abs=0.2)


def test_the_setpoint_echo_says_what_guided_does():
    bench = flying()
    echo = bench.last("POSITION_TARGET_LOCAL_NED")
    assert (echo.type_mask, echo.x, echo.z) == (3576, 0.0, 0.0)  # zeros after a take-off
    steady(bench, 2.0, 0.0, 0.0, duration_s=1.0)
    echo = bench.last("POSITION_TARGET_LOCAL_NED")
    assert (echo.type_mask, echo.vx) == (3079, 2.0)


def test_a_pilots_switch_takes_over_and_a_companion_may_ask_again():
    bench = flying(faults=["from=offboard,t=3,kind=rc_takeover"])
    stream = bench.velocity(2.0, 0.0, 0.0)
    assert bench.run(5.0, stream=stream, until=lambda: state(bench)[1] == LOITER)
    bench.run(3.0, stream=stream)
    assert speed(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert bench.vehicle.report()["setpoints_after_mode_shown"] > 40
    assert mode(bench, GUIDED) == ACCEPTED
    steady(bench, 2.0, 0.0, 0.0)
    assert speed(bench)[0] == pytest.approx(2.0, abs=0.1)


def test_a_lost_transmitter_returns_at_once_and_its_return_changes_no_mode():
    bench = flying(radio=True, faults=["from=offboard,t=2,kind=rc_loss,for=4"])
    bench.run(3.0, stream=bench.velocity(1.0, 0.0, 0.0))
    assert state(bench) == (0xD9, RTL, 5)
    bench.run(5.0)
    assert state(bench) == (0xD9, RTL, 4)
    words = [text for text in bench.texts() if "Radio" in text]
    assert words == ["Radio Failsafe", "Radio Failsafe Cleared"]


def test_low_battery_acts_only_if_told_to():
    bench = flying(faults=["from=offboard,t=1,kind=battery_low,level=0.1"])
    steady(bench, 1.0, 0.0, 0.0)
    assert bench.last("SYS_STATUS").battery_remaining == 10
    assert state(bench)[1] == GUIDED
    autopilot(bench).parameters.override("BATT_LOW_MAH", 500.0)
    autopilot(bench).parameters.override("BATT_FS_LOW_ACT", 1)
    steady(bench, 1.0, 0.0, 0.0, duration_s=2.0)
    assert state(bench)[1:] == (LAND, 5)


def test_texts_go_to_every_link_whole_and_without_a_tab():
    bench = booted(ground_links=(False, True))
    mode(bench, 99)
    bench.run(0.1)
    assert [m.text for m in bench.all("STATUSTEXT", link=1)][-1] == "No such mode 99"
    assert "ArduPilot Ready" in [m.text for m in bench.all("STATUSTEXT", link=0)]


# -- a transmitter by RC_CHANNELS_OVERRIDE ------------------------------------------------


def pulses(**channels):
    values = [channels.get(f"c{n}", 65535) for n in range(1, 9)]
    return mavlink.MAVLink_rc_channels_override_message(1, 1, *values)


def test_the_mode_switch_takes_over_when_it_moves_and_not_before():
    bench = flying()
    bench.send(pulses(c5=1800), identity=(255, 190))
    bench.run(0.2)
    assert state(bench)[1] == GUIDED  # it stood there already
    bench.send(pulses(c5=1700), identity=(255, 190))
    bench.run(0.2)
    assert state(bench)[1] == LOITER
    assert bench.command(SET_MODE, 1.0, GUIDED) == ACCEPTED
    bench.send(pulses(c5=1700), identity=(255, 190))
    bench.run(0.2)
    assert state(bench)[1] == GUIDED  # it has to move again
    bench.send(pulses(c5=1300), identity=(255, 190))
    bench.run(0.2)
    assert state(bench)[1] == LAND


def test_sticks_by_override_fly_loiter_and_are_forgotten_after_three_seconds():
    bench = flying()
    bench.command(SET_MODE, 1.0, LOITER)
    bench.send(pulses(c2=1000), identity=(255, 190))
    bench.run(2.0)
    assert bench.last("LOCAL_POSITION_NED").vx > 2.0
    bench.run(6.0)
    assert abs(bench.last("LOCAL_POSITION_NED").vx) < 0.3


def test_a_throttle_of_900_is_a_lost_transmitter():
    bench = flying()
    bench.send(pulses(c3=900), identity=(255, 190))
    bench.run(0.2)
    assert state(bench)[1:] == (RTL, 5)
    assert "Radio Failsafe" in bench.texts()
    bench.send(pulses(c3=1500), identity=(255, 190))
    bench.run(1.2)
    assert state(bench)[1:] == (RTL, 4)


def test_only_the_ground_station_may_override():
    bench = flying()
    bench.send(pulses(c5=1300, c3=900), identity=(1, 191))
    bench.run(0.2)
    assert state(bench)[1] == GUIDED


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
