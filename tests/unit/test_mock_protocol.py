"""What the PX4 personality answers, forwards and streams besides flying."""

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)


def booted(**options):
    bench = Bench(**options)
    bench.run(2.0)
    return bench


def gcs_heartbeat():
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def rates(bench, since_s, until_s, link=0):
    names = [r.name for r in bench.received if since_s < r.time_s <= until_s and r.link == link]
    return {name: names.count(name) / (until_s - since_s) for name in set(names)}


# -- commands and addresses ----------------------------------------------------------------


def test_unknown_command_is_unsupported():
    assert booted().command(31999) == UNSUPPORTED


@pytest.mark.parametrize("command", [519, 520, 410, 525, 528])
def test_legacy_requests_are_unsupported(command):
    assert booted().command(command) == UNSUPPORTED


@pytest.mark.parametrize(("system", "component"), [(1, 200), (2, 1), (0, 0)])
def test_p10_commands_for_others_meet_silence(system, component):
    assert booted().command(400, 1.0, system=system, component=component) is None


def test_acknowledgements_name_the_asker():
    bench = booted()
    bench.command(512, 148.0, identity=(255, 190))
    ack = bench.last("COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (255, 190)


def test_setpoints_are_never_acknowledged():
    bench = booted()
    bench.run(2.0, stream=bench.velocity(1.0, 0.0, 0.0))
    assert bench.all("COMMAND_ACK") == []


@pytest.mark.parametrize(
    ("params", "text"),
    [
        ((1.0, 99.0), "Unsupported main mode"),
        ((1.0, 4.0, 99.0), "Unsupported auto mode"),
        ((0.0, 6.0), "Unsupported base mode"),
    ],
    ids=["main", "sub", "base mode without the custom bit"],
)
def test_unknown_modes_are_temporarily_rejected(params, text):
    bench = booted()
    bench.send(gcs_heartbeat())
    assert bench.command(176, *params) == REJECTED
    bench.run(0.2)
    assert bench.texts() == [text]


def test_set_mode_message_is_obeyed_and_answered_as_command_176():
    bench = booted()
    assert bench.ask(mavlink.MAVLink_set_mode_message(1, 1, 0x00060000), 176) == ACCEPTED
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"


def test_reboot_is_denied_as_on_sitl():
    assert booted().command(246, 1.0) == DENIED


# -- streams and requests ------------------------------------------------------------------


def test_set_message_interval_changes_the_rate_stops_and_restores():
    bench = booted()
    name = "LOCAL_POSITION_NED"
    assert bench.command(511, 32.0, 100_000.0) == ACCEPTED
    bench.run(5.0)
    assert rates(bench, bench.time_s - 4.0, bench.time_s)[name] == pytest.approx(10.0, rel=0.05)
    assert bench.command(511, 32.0, -1.0) == ACCEPTED
    bench.run(2.0)
    assert name not in rates(bench, bench.time_s - 1.0, bench.time_s)
    assert bench.command(511, 32.0, 0.0) == ACCEPTED
    bench.run(5.0)
    assert rates(bench, bench.time_s - 4.0, bench.time_s)[name] == pytest.approx(30.0, rel=0.05)


def test_set_message_interval_of_an_unknown_message_fails():
    assert booted().command(511, 9999.0, 100_000.0) == FAILED


def test_intervals_belong_to_one_link():
    bench = booted(ground_links=(False, False))
    bench.command(511, 32.0, -1.0)
    bench.run(2.0)
    since = bench.time_s - 1.0
    assert "LOCAL_POSITION_NED" not in rates(bench, since, bench.time_s, link=0)
    assert rates(bench, since, bench.time_s, link=1)["LOCAL_POSITION_NED"] > 25.0


def test_request_data_stream_is_ignored():
    bench = booted()
    before = rates(bench, 1.0, 2.0)
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 2, 1))
    bench.run(2.0)
    after = rates(bench, 3.0, 4.0)
    assert after["ATTITUDE"] == pytest.approx(before["ATTITUDE"], rel=0.05)


@pytest.mark.parametrize(
    ("number", "name"),
    [(148, "AUTOPILOT_VERSION"), (49, "GPS_GLOBAL_ORIGIN"), (242, "HOME_POSITION")],
)
def test_request_message(number, name):
    bench = booted()
    before = len(bench.all(name))
    assert bench.command(512, float(number)) == ACCEPTED
    assert len(bench.all(name)) == before + 1


def test_autopilot_version_is_that_of_the_recorded_px4():
    bench = booted()
    bench.command(512, 148.0)
    version = bench.last("AUTOPILOT_VERSION")
    assert version.flight_sw_version == 0x01120080
    assert version.capabilities == 59647


def test_p19_origin_is_sent_once_and_again_only_when_it_changes():
    bench = Bench(faults=["t=20,kind=origin_move,north=10"])
    bench.run(19.0)
    assert len(bench.all("GPS_GLOBAL_ORIGIN")) == 1
    bench.run(5.0)
    first, second = bench.all("GPS_GLOBAL_ORIGIN")
    assert second.latitude - first.latitude == pytest.approx(10.0 / 111_195.0 * 1e7, rel=0.01)


def test_global_position_is_absent_until_valid():
    bench = Bench()
    bench.run(0.7)
    assert bench.all("GLOBAL_POSITION_INT") == []
    assert bench.all("LOCAL_POSITION_NED")
    bench.run(0.2)
    assert bench.last("GLOBAL_POSITION_INT").lat == 473977420


def test_p20_reset_counter_rises_during_boot_and_then_stands_still():
    bench = Bench()
    bench.run(10.0)
    counts = [message.reset_counter for message in bench.all("ODOMETRY")]
    assert counts == sorted(counts)
    assert counts[-1] == 11
    assert {m.reset_counter for m in bench.all("ODOMETRY", since_s=2.0)} == {11}
    assert {(m.frame_id, m.child_frame_id) for m in bench.all("ODOMETRY")} == {(1, 1)}


def test_timesync_and_ping_are_answered_at_once():
    bench = booted()
    bench.send(mavlink.MAVLink_timesync_message(0, 123456789))
    answers = [m for m in bench.all("TIMESYNC") if m.ts1 == 123456789]
    assert [m.tc1 for m in answers] == [round(bench.time_s * 1e9)]
    bench.send(mavlink.MAVLink_ping_message(7, 3, 0, 0), identity=(255, 190))
    pong = bench.last("PING")
    assert (pong.time_usec, pong.seq, pong.target_system, pong.target_component) == (7, 3, 255, 190)


def test_timesync_answers_of_others_are_not_answered():
    bench = booted()
    before = len(bench.all("TIMESYNC"))
    bench.send(mavlink.MAVLink_timesync_message(5, 123456789))
    assert len(bench.all("TIMESYNC")) == before


@pytest.mark.parametrize("mission_type", [0, 1, 2])
def test_mission_list_is_empty(mission_type):
    bench = booted()
    bench.send(
        mavlink.MAVLink_mission_request_list_message(1, 1, mission_type), identity=(255, 190)
    )
    count = bench.last("MISSION_COUNT")
    assert (count.count, count.mission_type, count.target_system) == (0, mission_type, 255)


def test_file_transfer_is_refused_politely():
    bench = booted()
    request = struct.pack("<HBBB", 7, 0, 4, 0).ljust(251, b"\0")
    bench.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
    answer = bytes(bench.last("FILE_TRANSFER_PROTOCOL").payload)
    assert (struct.unpack_from("<H", answer)[0], answer[3], answer[5]) == (8, 129, 4)


# -- texts and routing ---------------------------------------------------------------------


def test_texts_go_only_to_links_that_heard_a_ground_station():
    bench = booted(ground_links=(False, True))
    for _ in range(3):
        bench.send(gcs_heartbeat(), link=1, identity=(255, 190))
        bench.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), link=0)
        bench.command(400, 1.0)
        bench.run(0.5)
    assert bench.texts(link=0) == []
    assert "Armed by external command" in bench.texts(link=1)


def test_texts_end_in_a_tab_and_are_chunked_at_fifty():
    bench = booted()
    bench.send(gcs_heartbeat())
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    bench.run(0.2)
    chunks = [(m.text, m.id, m.chunk_seq) for m in bench.all("STATUSTEXT")]
    assert chunks == [
        ("Arming denied: Resolve system health failures firs", 1, 0),
        ("t\t", 1, 1),
    ]


def test_heartbeats_of_a_ground_station_reach_the_other_links():
    bench = booted(ground_links=(False, True))
    bench.send(gcs_heartbeat(), link=1, identity=(255, 190))
    assert [m.get_srcSystem() for m in bench.all("HEARTBEAT", link=0)].count(255) == 1
    assert [m.get_srcSystem() for m in bench.all("HEARTBEAT", link=1)].count(255) == 0


def test_messages_for_the_autopilot_are_not_passed_on():
    bench = booted(ground_links=(False, True))
    bench.send(bench.velocity(0.0, 0.0, 0.0)(), link=0)
    assert bench.all("SET_POSITION_TARGET_LOCAL_NED") == []


# -- consistency between messages ----------------------------------------------------------


def test_local_and_global_position_agree_on_px4s_sphere():
    bench = booted()
    bench.run(0.5, stream=bench.position(60.0, -80.0, -20.0))
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    bench.run(60.0, stream=bench.position(60.0, -80.0, -20.0))
    local, world = bench.last("LOCAL_POSITION_NED"), bench.last("GLOBAL_POSITION_INT")
    origin = bench.last("GPS_GLOBAL_ORIGIN")
    north = math.radians((world.lat - origin.latitude) * 1e-7) * 6371000.0
    east = math.radians((world.lon - origin.longitude) * 1e-7) * 6371000.0
    east *= math.cos(math.radians(origin.latitude * 1e-7))
    assert (north, east) == pytest.approx((local.x, local.y), abs=0.03)
    assert world.alt - origin.altitude == pytest.approx(-local.z * 1e3, abs=30)
    assert world.relative_alt == pytest.approx(-local.z * 1e3, abs=30)


# -- robustness ----------------------------------------------------------------------------


def test_undecodable_messages_are_sent_as_px4_sends_them():
    bench = booted()
    bench.run(4.0)
    ids = [int.from_bytes(received.packet[7:10], "little") for received in bench.received]
    assert [ids.count(number) for number in (290, 291)] == pytest.approx([60, 60], abs=3)
    packet = next(r.packet for r in bench.received if r.packet[7:10] == b"\xb4\x01\x00")
    assert struct.unpack("<II", packet[10:18].ljust(8, b"\0")) == (0x03040000, 0x03040000)


def test_messages_for_every_component_are_obeyed_and_passed_on():
    bench = booted(ground_links=(False, True))
    bench.send(bench.setpoint(type_mask=0xDC7, target=(1, 0))(), link=0)
    assert len(bench.all("SET_POSITION_TARGET_LOCAL_NED", link=1)) == 1
    assert bench.vehicle.autopilot.setpoints_received == 1


@pytest.mark.parametrize(
    ("frame", "altitude"), [(0, 499.4), (5, 499.4), (3, 10.0), (6, 10.0)], ids=str
)
def test_global_setpoints_are_flown_in_four_frames(frame, altitude):
    bench = booted()
    latitude = round((47.397742 + 10.0 / 111_195.0) * 1e7)

    def stream():
        return mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, 0xDF8, latitude, 85455940, altitude, *(0.0,) * 8
        )

    bench.run(0.3, stream=stream)
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    bench.run(20.0, stream=stream)
    last = bench.last("LOCAL_POSITION_NED")
    assert (last.x, last.y, last.z) == pytest.approx((10.0, 0.0, -10.0), abs=0.3)


def test_global_setpoints_in_other_frames_are_refused():
    bench = booted()
    bench.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 1, 0xDF8, 473977420, 85455940, 10.0, *(0.0,) * 8
        )
    )
    assert bench.vehicle.report()["setpoints_refused"] == 1


# -- identity, slow answers, missions ------------------------------------------------------


def test_another_system_id_is_another_vehicle():
    bench = Bench(Settings(place_vehicle(None, None), system_id=7))
    bench.run(2.0)
    assert {received.packet[5] for received in bench.received} == {7}
    assert bench.command(400, 1.0, system=1) is None
    assert bench.command(400, 1.0) == 0
    bench.send(mavlink.MAVLink_param_request_read_message(7, 1, b"MAV_SYS_ID", -1))
    bench.run(0.1)
    assert struct.unpack("<I", bench.last("PARAM_VALUE").get_msgbuf()[10:14])[0] == 7


@pytest.mark.parametrize("kind", ["ack_late", "in_progress"])
def test_an_answer_may_take_its_time(kind):
    bench = Bench(faults=[f"t=1.5,for=5,kind={kind},ms=800"])
    bench.run(2.0)
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    asked_s = bench.time_s
    bench.send(arm)
    bench.run(1.0)
    acks = [(r.time_s, r.message.result) for r in bench.received if r.name == "COMMAND_ACK"]
    assert [result for _, result in acks] == ([5, 0] if kind == "in_progress" else [0])
    assert acks[-1][0] - asked_s == pytest.approx(0.8, abs=0.02)
    bench.run(4.0)
    assert bench.command(400, 1.0) == 0


def test_an_upload_of_a_mission_is_refused_and_clearing_none_is_done():
    bench = Bench()
    bench.run(2.0)
    bench.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    bench.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 1))
    answers = [(m.type, m.mission_type, m.target_component) for m in bench.all("MISSION_ACK")]
    assert answers == [(3, 0, 191), (0, 1, 191)]
