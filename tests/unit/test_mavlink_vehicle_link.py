"""The vehicle over MAVLink: what leaves, which targets are heard, and the link's own figures."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.statustext import TextAssembler, encode_text
from companion.vehicle import EventKind, Severity, SystemStatus


def events(bench, kind=None):
    return [event for event in bench.vehicle.take_events() if kind in (None, event.kind)]


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=180))
def test_what_we_say_is_what_another_companion_reads(text):
    assembler = TextAssembler()
    read = []
    for message in encode_text(text, 4, 77):
        frame = message.pack(dialect.MAVLink(None, 1, 191))
        read += assembler.add(dialect.MAVLink(None).decode(bytearray(frame)), 0.0)
    assert read == [(4, text)]


def test_say(bench):
    vehicle = bench.attach()
    bench.transport.sent.clear()
    vehicle.say("standing down: pilot took LOITER", Severity.WARNING)
    (message,) = bench.transport.sent_of("STATUSTEXT")
    assert (message.severity, message.text) == (4, "standing down: pilot took LOITER")
    assert (message.id, message.chunk_seq) == (0, 0)
    vehicle.say("é" + "x" * 60)
    assert [(m.id, m.chunk_seq) for m in bench.transport.sent_of("STATUSTEXT")[1:]] == [
        (2, 0),
        (2, 1),
    ]


# -- setpoints and heartbeat -------------------------------------------------------------------


def test_one_call_one_setpoint_and_silence_after(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.transport.sent.clear()
    vehicle.send_velocity(np.array((1.0, -2.0, 0.5)))
    (message,) = bench.transport.sent
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.vx, message.vy, message.vz) == (1.0, -2.0, 0.5)
    assert (message.type_mask, message.coordinate_frame) == (0b1101_1100_0111, 1)
    assert (message.target_system, message.target_component) == (1, 1)
    bench.run(30.0)
    assert len(bench.transport.sent_of("SET_POSITION_TARGET_LOCAL_NED")) == 1
    assert bench.transport.sent_of("HEARTBEAT") == []
    assert vehicle.stats().setpoints_sent == 1


def test_a_setpoint_with_yaw(bench):
    vehicle = bench.attach()
    vehicle.send_velocity(np.zeros(3), yaw_rad=-1.5)
    message = bench.transport.sent[-1]
    assert (message.type_mask, message.yaw) == (2503, -1.5)


@pytest.mark.parametrize(
    ("velocity", "yaw_rad"),
    [
        ((math.nan, 0, 0), None),
        ((0, math.inf, 0), None),
        ((0, 0, -math.inf), None),
        ((math.inf, -math.inf, 0), None),
        ((0, 1e39, 0), None),
        ((0, 0, -1000.1), None),
        ((0, 0, 0), math.nan),
        ((0, 0), None),
        ((0, 0, 0, 0), None),
        (((0, 0, 0),), None),
    ],
)
def test_nothing_but_finite_velocities_leaves(bench, velocity, yaw_rad):
    vehicle = bench.attach()
    bench.transport.sent.clear()
    with pytest.raises(ValueError, match=r"must be finite|shape"):
        vehicle.send_velocity(np.array(velocity, dtype=float), yaw_rad)
    assert bench.transport.sent == []
    assert vehicle.stats().setpoints_sent == 0


def test_our_heartbeat_is_an_onboard_controllers(bench):
    vehicle = bench.attach()
    vehicle.send_heartbeat(SystemStatus.CRITICAL)
    message = bench.transport.sent[-1]
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
    assert (message.type, message.autopilot, message.system_status) == (18, 8, 5)
    assert (message.base_mode, message.custom_mode) == (0, 0)


# -- targets -----------------------------------------------------------------------------------


def global_position(lat=473980000, lon=85460000, alt=500_000):
    return dialect.MAVLink_global_position_int_message(7000, lat, lon, alt, 10_000, 150, -20, 5, 0)


def follow_target(lat=473980000, lon=85460000, alt=500.0, velocity=(1, 2, 3), capabilities=3):
    zeros = (0.0, 0.0, 0.0)
    return dialect.MAVLink_follow_target_message(
        8000, capabilities, lat, lon, alt, velocity, zeros, (1, 0, 0, 0), zeros, zeros, 0
    )


def test_a_targets_position(bench):
    vehicle = bench.attach(target_sysids=(42,))
    bench.sender(42).send(global_position())
    bench.run()
    report = vehicle.targets()[42]
    assert (report.source, report.system_id, report.source_time_s) == ("GLOBAL_POSITION_INT", 42, 7)
    assert report.position.latitude_deg == pytest.approx(47.398)
    assert report.position.altitude_m == 500.0
    np.testing.assert_allclose(report.velocity_ned_mps, (1.5, -0.2, 0.05))
    assert vehicle.stats().packets_foreign == 0


def test_a_follow_target(bench):
    vehicle = bench.attach(target_sysids=(255,))
    ground_station = bench.sender(255, 190)
    ground_station.send(follow_target())
    bench.run()
    np.testing.assert_allclose(vehicle.targets()[255].velocity_ned_mps, (1, 2, 3))
    ground_station.send(follow_target(capabilities=1))
    bench.run()
    assert vehicle.targets()[255].velocity_ned_mps is None
    ground_station.send(follow_target(velocity=(math.nan, 0, 0)))
    bench.run()
    assert vehicle.targets()[255].velocity_ned_mps is None
    assert vehicle.targets()[255].source_time_s == 8.0


@pytest.mark.parametrize(
    "message",
    [
        global_position(lat=0, lon=0, alt=0),
        global_position(lat=910000000),
        global_position(lon=-1810000000),
        follow_target(lat=0, lon=0),
        follow_target(alt=math.nan),
        follow_target(alt=math.inf),
        follow_target(capabilities=0),
    ],
)
def test_what_is_no_place_is_no_target(bench, message):
    vehicle = bench.attach(target_sysids=(42,))
    bench.sender(42).send(message)
    bench.run()
    assert dict(vehicle.targets()) == {}


def test_only_named_targets_are_heard(bench):
    vehicle = bench.attach(target_sysids=(42,))
    bench.sender(43).send(global_position())
    bench.autopilot.send(global_position())
    bench.run()
    assert dict(vehicle.targets()) == {}
    assert vehicle.stats().packets_foreign == 1


def test_targets_are_a_copy(bench):
    vehicle = bench.attach(target_sysids=(42,))
    bench.sender(42).send(global_position())
    bench.run()
    before = vehicle.targets()
    bench.sender(42).send(global_position(alt=600_000))
    bench.run()
    assert before[42].position.altitude_m == 500.0


# -- counting, clocks and the tap --------------------------------------------------------------


def test_stats_count_losses_of_the_vehicle(bench):
    vehicle = bench.attach()
    for number in range(10):
        frame = bench.autopilot.pack(dialect.MAVLink_system_time_message(0, 60_000))
        if number not in (3, 4, 7):
            bench.transport.deliver(frame)
    bench.transport.deliver(b"noise")
    bench.run()
    stats = vehicle.stats()
    assert (stats.packets_received, stats.packets_lost, stats.bytes_bad) == (8, 3, 5)
    assert stats.loss_percent == pytest.approx(100 * 3 / 11)


def test_rates_are_measured(bench):
    vehicle = bench.attach()
    for _ in range(100):
        bench.attitude()
        bench.run(0.1)
    assert vehicle.stats().rates_hz["ATTITUDE"] == pytest.approx(10.0, abs=1.0)


def test_the_tap_sees_every_frame_of_both_directions(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.sender(200).heartbeat()
    bench.run()
    vehicle.send_heartbeat(SystemStatus.ACTIVE)
    received = [frame for sent, _, frame in bench.tapped if not sent]
    sent = [frame for sent, _, frame in bench.tapped if sent]
    reader = dialect.MAVLink(None)
    assert len(received) == 7
    assert all(reader.decode(bytearray(frame)).get_type() != "BAD_DATA" for frame in received)
    assert len(sent) == len(bench.transport.sent)
    assert [time_s for _, time_s, _ in bench.tapped] == sorted(t for _, t, _ in bench.tapped)


def test_timesync_is_answered_once(bench):
    bench.attach()
    bench.autopilot.send(dialect.MAVLink_timesync_message(0, 123456789))
    bench.autopilot.send(dialect.MAVLink_timesync_message(55, 123456789))
    bench.run()
    (reply,) = bench.transport.sent_of("TIMESYNC")
    assert reply.ts1 == 123456789
    assert reply.tc1 == pytest.approx(bench.transport.now_s * 1e9, rel=1e-3)


def test_packets_that_could_not_be_sent_are_told(bench):
    bench.attach()
    bench.run(2.0)
    events(bench)
    bench.transport.send_errors = 3
    bench.run(1.1)
    (event,) = events(bench, EventKind.LINK_ERROR)
    assert event.text.startswith("3 packets")
    bench.run(3.0)
    assert events(bench, EventKind.LINK_ERROR) == []


def test_wait_until_takes_in_what_has_come_though_the_deadline_is_past(bench):
    vehicle = bench.attach()
    bench.position()
    bench.attitude()
    vehicle.wait_until(bench.transport.now_s - 5.0)
    assert vehicle.state() is not None


def test_what_lay_about_while_the_caller_was_away_is_not_taken_for_new(bench):
    vehicle = bench.attach()
    bench.flying()
    left_s = bench.transport.now_s
    bench.position(x=5.0)
    bench.transport.now_s += 2.0  # away: not waiting on the link
    vehicle.wait_until(bench.transport.now_s)
    assert vehicle.state().position_ned_m[0] == 5.0
    assert vehicle.state().time_s == left_s
    bench.run(0.05)
    bench.position(x=6.0)
    bench.run(0.05)
    assert bench.transport.now_s - vehicle.state().time_s <= 0.05


def test_its_time_stamp_tells_when_a_position_was_made_even_after_an_absence(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.position(boot_ms=70_000)
    bench.run(0.05)
    start_s = vehicle.state().measured_s
    assert start_s == pytest.approx(vehicle.state().time_s, abs=0.01)
    bench.position(boot_ms=71_900)
    bench.transport.now_s += 2.0  # away: what is read now is stamped with the last look
    vehicle.wait_until(bench.transport.now_s)
    assert vehicle.state().time_s < start_s + 0.1
    assert vehicle.state().measured_s == pytest.approx(start_s + 1.9)


def test_a_short_absence_is_no_absence(bench):
    vehicle = bench.attach()
    bench.flying()
    bench.position(x=5.0)
    bench.transport.now_s += 0.09
    vehicle.wait_until(bench.transport.now_s)
    assert vehicle.state().time_s == bench.transport.now_s


def test_close_sends_nothing(bench):
    vehicle = bench.attach()
    bench.transport.sent.clear()
    vehicle.close()
    assert bench.transport.closed
    assert bench.transport.sent == []
