"""PX4 with a pilot: sticks that take over, and manual control that is lost (P12, P13, P14)."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings
from tests.unit.px4_bench import (
    ACCEPTED,
    OFFBOARD,
    POSCTL,
    REJECTED,
    SET_MODE,
    flying,
    gcs_heartbeat,
    state,
    sticks,
)


def stick_sweep(bench, duration_s):
    """Push the stick forward from 0 to 0.9 within ``duration_s``, at 20 Hz, while streaming."""
    stream = bench.velocity(1.0, 0.0, 0.0)
    steps = max(1, round(duration_s * 20))
    for step in range(steps + 1):
        bench.send(sticks(x=round(900 * step / steps))())
        bench.run(0.05, stream=stream)


# -- the pilot -----------------------------------------------------------------------------


def test_position_mode_needs_a_pilot_in_the_air():
    bench = flying()
    assert bench.command(SET_MODE, *POSCTL) == REJECTED


@pytest.mark.parametrize("duration_s", [0.3, 0.6, 1.0])
def test_p12_fast_sticks_take_over_and_stay(duration_s):
    bench = flying()
    bench.run(1.0, stream=sticks())
    bench.command(SET_MODE, *OFFBOARD)
    bench.send(bench.velocity(0.0, 0.0, 0.0)())
    bench.command(SET_MODE, *OFFBOARD)
    stick_sweep(bench, duration_s)
    assert bench.vehicle.autopilot.mode.name == "POSCTL"
    for _ in range(40):
        bench.send(sticks()())
        bench.run(0.05, stream=bench.velocity(1.0, 0.0, 0.0))
    assert bench.vehicle.autopilot.mode.name == "POSCTL"
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED


@pytest.mark.parametrize("duration_s", [0.01, 2.0, 9.0], ids=["single step", "2 s", "slow"])
def test_p12_slow_sticks_and_a_single_jump_do_not_take_over(duration_s):
    bench = flying()
    bench.run(1.0, stream=sticks())
    bench.send(bench.velocity(0.0, 0.0, 0.0)())
    bench.command(SET_MODE, *OFFBOARD)
    stick_sweep(bench, duration_s)
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"


def test_p13_losing_the_pilot_holds_five_seconds_and_returns_despite_the_stream():
    settings = Settings(place_vehicle(None, None), radio=True)
    bench = flying(settings=settings, faults=["from=offboard,t=20,kind=rc_loss"])
    stream = bench.velocity(0.5, 0.0, 0.0)
    px4 = bench.vehicle.autopilot
    assert bench.run(30.0, stream=stream, until=lambda: px4.mode.name == "LOITER")
    lost_s = bench.time_s
    bench.run(1.1, stream=stream)
    assert state(bench) == (0x9D, 0x03040000, 5)
    assert bench.run(10.0, stream=stream, until=lambda: px4.mode.name == "RTL")
    assert bench.time_s - lost_s == pytest.approx(5.0, abs=0.2)


def test_p13_a_pilot_who_never_was_is_not_missed():
    bench = flying()
    bench.run(5.0, stream=bench.velocity(0.5, 0.0, 0.0))
    assert bench.vehicle.autopilot.failsafe.cause is None


def test_p13_com_rcl_except_keeps_offboard_without_the_pilot():
    settings = Settings(place_vehicle(None, None), radio=True)
    bench = flying(settings=settings)
    bench.vehicle.autopilot.parameters.override("COM_RCL_EXCEPT", 4)
    bench.vehicle.autopilot.pilot.radio = False
    bench.run(8.0, stream=bench.velocity(0.5, 0.0, 0.0))
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"


def test_p14_a_silent_companion_is_only_mentioned():
    bench = flying()
    onboard = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    bench.send(onboard)
    hover = bench.velocity(0.0, 0.0, 0.0)
    bench.run(4.5, stream=hover)
    bench.send(gcs_heartbeat(), identity=(255, 190))
    assert bench.texts() == []
    bench.run(1.0, stream=hover)
    assert bench.texts() == ["Connection to mission computer lost"]
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"


def test_a_stick_is_a_push_against_a_drag_and_letting_go_brakes():
    bench = flying()
    bench.run(1.0, stream=sticks())
    assert bench.command(SET_MODE, *POSCTL) == ACCEPTED
    bench.run(3.0, stream=sticks())
    bench.run(2.0, stream=sticks(x=900))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(3.2, abs=0.3)
    bench.run(8.0, stream=sticks(x=900))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(6.7, abs=0.3)
    bench.run(6.0, stream=sticks())
    last = bench.last("LOCAL_POSITION_NED")
    assert math.hypot(last.vx, last.vy) < 0.3
    bench.run(3.0, stream=sticks(x=90))  # within the dead zone
    assert math.hypot(bench.last("LOCAL_POSITION_NED").vx, last.vy) < 0.3
