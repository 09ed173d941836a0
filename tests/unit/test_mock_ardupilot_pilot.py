"""ArduCopter with a pilot and a ground station: sticks, switches, lost links (A13, A14, A17)."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.unit.copter_bench import (
    ACCEPTED,
    BRAKE,
    GUIDED,
    LAND,
    LOITER,
    RTL,
    SET_MODE,
    autopilot,
    flying,
    gcs_heartbeat,
    mode,
    position,
    speed,
    state,
    steady,
)


def pulses(**channels):
    values = [channels.get(f"c{n}", 65535) for n in range(1, 9)]
    return mavlink.MAVLink_rc_channels_override_message(1, 1, *values)


# -- A13 to A17: links with a pilot and a ground station -----------------------------------


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


# -- the rest of what was measured ---------------------------------------------------------


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


# -- a transmitter by RC_CHANNELS_OVERRIDE ------------------------------------------------


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
