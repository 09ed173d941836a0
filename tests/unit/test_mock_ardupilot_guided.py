"""ArduCopter in GUIDED: what it makes of setpoints, each rule as one test (A1 to A9)."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.unit.copter_bench import (
    ACCEPTED,
    BRAKE,
    GUIDED,
    LOITER,
    RTL,
    TAKEOFF,
    armed,
    autopilot,
    flying,
    mode,
    position,
    speed,
    state,
    steady,
)

VELOCITY = 0xDC7
NAN = math.nan


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


# -- the rest of what was measured ---------------------------------------------------------


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
