"""What ArduCopter sends, when and to whom (A18 to A21)."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.unit.copter_bench import (
    ACCEPTED,
    ARM,
    DENIED,
    FAILED,
    GUIDED,
    INTERVAL,
    LAND,
    LOITER,
    REQUEST,
    SET_MODE,
    STABILIZE,
    TAKEOFF,
    UNSUPPORTED,
    autopilot,
    booted,
    copter,
    flying,
    gcs_heartbeat,
    mode,
    state,
    steady,
)

ALL, POSITION_STREAM = 0, 6


def streams(bench, since_s):
    return {r.name for r in bench.received if r.time_s > since_s} - {"HEARTBEAT", "STATUSTEXT"}


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

    def ekf():
        return bench.last("EKF_STATUS_REPORT").flags

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


def test_texts_go_to_every_link_whole_and_without_a_tab():
    bench = booted(ground_links=(False, True))
    mode(bench, 99)
    bench.run(0.1)
    assert [m.text for m in bench.all("STATUSTEXT", link=1)][-1] == "No such mode 99"
    assert "ArduPilot Ready" in [m.text for m in bench.all("STATUSTEXT", link=0)]
