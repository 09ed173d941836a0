"""PX4 in OFFBOARD: signs of life, setpoints, their loss and return, each as one test."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings
from tests.unit.px4_bench import (
    ACCEPTED,
    ARM,
    LOITER,
    NAN,
    OFFBOARD,
    REJECTED,
    SET_MODE,
    booted,
    flying,
    gcs_heartbeat,
    mode,
    state,
)


def lost_at(bench):
    """Stop the stream and return how long it takes to leave OFFBOARD."""
    lost_s = bench.time_s
    assert bench.run(3.0, until=lambda: bench.vehicle.autopilot.mode.name != "OFFBOARD")
    return bench.time_s - lost_s


# -- signs of life -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["local", "global", "attitude"])
def test_p1_any_setpoint_message_at_two_hertz_is_a_sign_of_life(kind):
    bench = booted()
    streams = {
        "local": bench.velocity(0.0, 0.0, -0.5),
        "global": lambda: mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0xDC7, 0, 0, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0
        ),
        "attitude": lambda: mavlink.MAVLink_set_attitude_target_message(
            0, 1, 1, 7, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.6
        ),
    }
    stream = streams[kind]
    bench.run(1.0, stream=stream, rate_hz=2.0)
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED
    assert bench.command(ARM, 1.0) == ACCEPTED
    bench.run(8.0, stream=stream, rate_hz=2.0)
    assert mode(bench) == 0x00060000
    assert bench.vehicle.autopilot.failsafe_words is None


def test_p5_the_failsafe_is_told_after_one_second_and_shown_in_the_next_heartbeat():
    bench = flying()
    bench.send(gcs_heartbeat(), identity=(255, 190))
    bench.run(1.0, stream=bench.velocity(2.0, 0.0, 0.0))
    silent_s = bench.time_s
    bench.received.clear()
    bench.run(3.0)
    told_s, shown_s = (
        next(
            r.time_s
            for r in bench.received
            if r.name == name and getattr(r.message, field) in (value, f"{value}\t")
        )
        for name, field, value in (
            ("STATUSTEXT", "text", "Failsafe activated"),
            ("HEARTBEAT", "system_status", 5),
        )
    )
    assert told_s - silent_s == pytest.approx(1.0, abs=0.1)
    assert 0.0 <= shown_s - told_s <= 1.0


# -- offboard in the air -------------------------------------------------------------------


@pytest.mark.parametrize(
    "velocity",
    [(2.0, 0.0, 0.0), (0.0, -1.5, -0.5), (-3.0, 1.0, -0.5)],
    ids=["north", "west", "mixed"],
)
def test_velocity_setpoints_are_followed_axis_by_axis(velocity):
    bench = flying()
    bench.run(5.0, stream=bench.velocity(*velocity))
    last = bench.last("LOCAL_POSITION_NED")
    north, east, down = velocity
    # Horizontally 16 % are still missing after 5 s, as recorded; in the end there is all of it.
    assert (last.vx, last.vy) == pytest.approx((0.84 * north, 0.84 * east), abs=0.1)
    assert last.vz == pytest.approx(down, abs=0.05)
    bench.run(25.0, stream=bench.velocity(*velocity))
    last = bench.last("LOCAL_POSITION_NED")
    assert (last.vx, last.vy, last.vz) == pytest.approx(velocity, abs=0.05)


def test_p3_offboard_without_a_stream_is_rejected_while_armed():
    bench = flying()
    bench.command(SET_MODE, *LOITER)
    bench.run(3.0)
    assert bench.command(SET_MODE, *OFFBOARD) == REJECTED
    bench.send(bench.velocity(0.0, 0.0, 0.0)())
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED


def test_p4_setpoint_loss_without_pilot_returns_after_one_second():
    bench = flying()
    bench.run(1.0, stream=bench.velocity(3.0, 0.0, 0.0))
    assert lost_at(bench) == pytest.approx(1.0, abs=0.1)
    bench.run(1.1)
    assert state(bench) == (0x9D, 0x05040000, 5)


def test_p4_setpoint_loss_with_a_pilot_gives_position_mode():
    bench = flying(settings=Settings(place_vehicle(None, None), radio=True))
    bench.run(1.0, stream=bench.velocity(3.0, 0.0, 0.0))
    assert lost_at(bench) == pytest.approx(1.0, abs=0.1)
    bench.run(1.1)
    assert state(bench) == (0xD1, 0x00030000, 5)


@pytest.mark.parametrize(("value", "custom"), [(3, 0x05040000), (4, 0x06040000), (5, 0x03040000)])
def test_p4_com_obl_rc_act_chooses_the_action(value, custom):
    bench = flying()
    bench.vehicle.autopilot.parameters.override("COM_OBL_RC_ACT", value)
    lost_at(bench)
    bench.run(1.1)
    assert mode(bench) == custom


@pytest.mark.parametrize("period_s", [0.25, 0.5, 0.9])
def test_p2_slow_streams_below_one_second_hold_offboard(period_s):
    bench = flying()
    modes = set()
    stream = bench.velocity(0.5, 0.0, 0.0)
    for _ in range(12):
        bench.send(stream())
        bench.run(period_s)
        modes.add(bench.vehicle.autopilot.mode.name)
    assert modes == {"OFFBOARD"}


def test_p2_a_stream_slower_than_the_timeout_flaps():
    bench = flying()
    stream = bench.velocity(0.5, 0.0, 0.0)
    modes = []
    for _ in range(4):
        bench.send(stream())
        bench.run(0.2)
        modes.append(bench.vehicle.autopilot.mode.name)
        bench.run(1.3)
        modes.append(bench.vehicle.autopilot.mode.name)
    assert modes == ["OFFBOARD", "RTL"] * 4


def test_p6_offboard_is_re_entered_when_the_stream_resumes_without_any_request():
    bench = flying()
    bench.run(1.0, stream=bench.velocity(3.0, 0.0, 0.0))
    bench.run(4.0)
    assert mode(bench) == 0x05040000
    bench.run(1.2, stream=bench.velocity(0.0, 1.0, 0.0))
    assert state(bench) == (0x91, 0x00060000, 4)


def test_p6_offboard_is_re_entered_even_from_a_pilot():
    bench = flying(settings=Settings(place_vehicle(None, None), radio=True))
    bench.run(3.0)
    assert mode(bench) == 0x00030000
    bench.run(1.2, stream=bench.velocity(0.0, 1.0, 0.0))
    assert mode(bench) == 0x00060000


def test_p6_no_re_entry_when_somebody_chose_a_mode_during_the_failsafe():
    bench = flying()
    bench.run(3.0)
    assert bench.command(SET_MODE, *LOITER) == ACCEPTED
    bench.run(1.1)
    assert state(bench) == (0x9D, 0x03040000, 4)
    bench.run(5.0, stream=bench.velocity(2.0, 0.0, 0.0))
    assert mode(bench) == 0x03040000


def test_p11_setpoints_outside_offboard_feed_the_watchdog_but_do_not_move():
    bench = flying()
    bench.command(SET_MODE, *LOITER)
    bench.run(3.0)
    before = bench.last("LOCAL_POSITION_NED")
    bench.run(5.0, stream=bench.velocity(5.0, 0.0, 0.0))
    after = bench.last("LOCAL_POSITION_NED")
    assert math.dist((before.x, before.y, before.z), (after.x, after.y, after.z)) < 0.2
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED
    assert bench.vehicle.report()["setpoints_outside_offboard"] >= 100


@pytest.mark.parametrize("frame", [7, 9, 12, 20])
def test_p7_other_frames_are_dropped_with_a_text_and_do_not_count_as_stream(frame):
    bench = flying()
    bench.send(gcs_heartbeat())
    stream = bench.setpoint(velocity=(1.0, 0.0, 0.0), type_mask=0xDC7, frame=frame)
    bench.run(1.9, stream=stream)
    assert bench.vehicle.autopilot.mode.name == "RTL"
    text = f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"
    assert bench.texts().count(text) > 10


def test_p7_body_frame_is_turned_by_yaw():
    bench = flying()
    east = bench.setpoint(velocity=(0.0, 0.0, 0.0), type_mask=0x9C7, yaw=math.pi / 2)
    bench.run(4.0, stream=east)
    assert bench.last("ATTITUDE").yaw == pytest.approx(math.pi / 2, abs=0.05)
    bench.run(4.0, stream=bench.setpoint(velocity=(2.0, 0.0, 0.0), type_mask=0xDC7, frame=8))
    last = bench.last("LOCAL_POSITION_NED")
    assert last.vx == pytest.approx(0.0, abs=0.01)
    assert last.vy == pytest.approx(1.65, abs=0.1)


def test_p8_all_axes_masked_is_invalid_and_does_not_count_as_stream():
    bench = flying()
    bench.send(gcs_heartbeat())
    bench.run(2.0, stream=bench.setpoint(type_mask=0xFFF))
    assert bench.vehicle.autopilot.mode.name == "RTL"
    assert "SET_POSITION_TARGET_LOCAL_NED invalid" in bench.texts()


@pytest.mark.parametrize(
    ("velocity", "type_mask"),
    [((NAN, 0.0, 0.0), 0xDC7), ((2.0, 2.0, 0.0), 0xDE7)],
    ids=["nan in vx", "vz masked"],
)
def test_p8_an_uncontrolled_axis_counts_as_stream_but_does_not_move(velocity, type_mask):
    bench = flying()
    before = bench.last("LOCAL_POSITION_NED")
    bench.run(4.0, stream=bench.setpoint(velocity=velocity, type_mask=type_mask))
    after = bench.last("LOCAL_POSITION_NED")
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"
    assert math.dist((before.x, before.y), (after.x, after.y)) < 0.2


def test_p8_force_is_refused():
    bench = flying()
    bench.run(2.0, stream=bench.setpoint(velocity=(1.0, 0.0, 0.0), type_mask=0xC07 | 0x200))
    assert bench.vehicle.autopilot.mode.name == "RTL"


def test_p9_position_leads_and_velocity_is_its_feed_forward():
    bench = flying()
    both = bench.setpoint(position=(5.0, 0.0, -10.0), velocity=(0.0, 0.0, 0.0), type_mask=0xDC0)
    bench.run(15.0, stream=both)
    assert bench.last("LOCAL_POSITION_NED").x == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("target", [(2, 1), (1, 2)], ids=["other system", "other component"])
def test_p10_setpoints_for_others_are_ignored(target):
    bench = flying()
    bench.run(2.0, stream=bench.setpoint(velocity=(1.0, 0.0, 0.0), type_mask=0xDC7, target=target))
    assert bench.vehicle.autopilot.mode.name == "RTL"


@pytest.mark.parametrize("target", [(0, 0), (1, 0), (0, 1)])
def test_p10_zero_means_everybody(target):
    bench = flying()
    bench.run(2.0, stream=bench.setpoint(velocity=(1.0, 0.0, 0.0), type_mask=0xDC7, target=target))
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"


def test_silly_velocities_are_limited_to_mpc_xy_vel_max():
    bench = flying()
    bench.run(6.0, stream=bench.velocity(50.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(9.8, abs=0.5)  # recorded
    bench.run(25.0, stream=bench.velocity(50.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(12.0, abs=0.2)


# -- going somewhere and coming down -------------------------------------------------------


def test_nothing_is_controlled_in_offboard_before_the_first_setpoint():
    bench = booted()
    bench.command(SET_MODE, *OFFBOARD)
    bench.received.clear()
    bench.run(2.0)
    names = {received.name for received in bench.received}
    assert not names & {"ATTITUDE_TARGET", "POSITION_TARGET_LOCAL_NED", "SERVO_OUTPUT_RAW"}
    bench.run(1.0, stream=bench.velocity(0.0, 0.0, 0.0))
    names = {received.name for received in bench.received}
    assert {"ATTITUDE_TARGET", "POSITION_TARGET_LOCAL_NED", "SERVO_OUTPUT_RAW"} <= names
