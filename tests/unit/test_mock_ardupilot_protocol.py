"""What the ArduCopter personality answers, forwards and survives besides flying."""

import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from sim.mock.ardupilot.parameters import COPTER_DEFAULTS, CopterParameters
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.fault_kinds import KINDS
from sim.mock.faults import parse_fault
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

GUIDED, HOME = 4, (-353632610, 1491652299)


def booted(**options):
    bench = Bench(Settings(place_vehicle(None, None, ARDUPILOT), personality=ARDUPILOT), **options)
    bench.run(2.0)
    return bench


def flying(**options):
    bench = booted(**options)
    bench.command(511, 32.0, 50_000.0)
    bench.command(176, 1.0, GUIDED)
    bench.command(400, 1.0)
    assert bench.command(22, 0, 0, 0, 0, 0, 0, 10.0) == 0
    bench.run(14.0)
    return bench


def ask_param(bench, name):
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    values = [m for m in bench.all("PARAM_VALUE") if m.param_id == name]
    return values[-1] if values else None


# -- parameters ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "wire_type"),
    [
        ("SYSID_MYGCS", 255.0, 4),
        ("FS_GCS_ENABLE", 0.0, 2),
        ("FS_OPTIONS", 16.0, 6),
        ("GUID_TIMEOUT", 3.0, 9),
        ("WPNAV_SPEED", 1000.0, 9),
    ],
)
def test_values_travel_cast_to_float_with_their_recorded_types(name, value, wire_type):
    message = ask_param(booted(), name)
    assert (message.param_value, message.param_type) == (value, wire_type)
    assert message.param_index == 65535  # an answer to a name has none
    assert struct.unpack("<f", bytes(message.get_msgbuf())[10:14]) == (value,)


def test_the_list_is_complete_and_every_index_can_be_read():
    bench = booted()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1))
    listed = {m.param_index: m.param_id for m in bench.all("PARAM_VALUE")}
    assert sorted(listed.values()) == sorted(COPTER_DEFAULTS)
    assert sorted(listed) == list(range(len(COPTER_DEFAULTS)))
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 5))
    assert (bench.last("PARAM_VALUE").param_id, bench.last("PARAM_VALUE").param_index) == (
        listed[5],
        5,
    )


def test_set_takes_any_type_and_answers_with_its_own():
    bench = booted()
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"FS_OPTIONS", 3.0, 9))
    answer = bench.last("PARAM_VALUE")
    assert (answer.param_value, answer.param_type, answer.param_index) == (3.0, 6, 65535)


@pytest.mark.parametrize(
    ("name", "value", "stored"),
    [
        ("FS_GCS_ENABLE", 300.0, 127),
        ("LAND_SPEED", -1e9, -32768),
        ("LAND_SPEED", 50.6, 51),
        ("GUID_TIMEOUT", 0.5, 0.5),
    ],
)
def test_integers_are_rounded_and_kept_in_their_type(name, value, stored):
    table = CopterParameters()
    assert table.store(name, 9, struct.pack("<f", value))
    assert table.number(name) == stored


def test_unknown_names_and_nans_change_nothing_and_meet_silence():
    bench = booted()
    assert ask_param(bench, "NO_SUCH_THING") is None
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", math.nan, 9))
    assert bench.all("PARAM_VALUE") == []
    assert bench.vehicle.autopilot.parameters.number("GUID_TIMEOUT") == 3.0


def test_every_name_fits_the_wire_and_every_value_its_type():
    table = CopterParameters()
    for name, value in COPTER_DEFAULTS.items():
        assert len(name) <= 16
        assert table.store(name, 9, table.wire_bytes(name))
        assert table.number(name) == pytest.approx(value)


# -- answers -------------------------------------------------------------------------------


def test_missions_are_empty_and_timesync_is_answered():
    bench = booted()
    bench.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    bench.send(mavlink.MAVLink_timesync_message(0, 77))
    assert bench.last("MISSION_COUNT").count == 0
    assert bench.last("TIMESYNC").ts1 == 77


def test_requests_of_version_and_home():
    bench = booted()
    assert bench.command(520, 1.0) == 0
    assert bench.last("AUTOPILOT_VERSION").flight_sw_version == 0x040603FF
    before = len(bench.all("HOME_POSITION"))
    assert bench.command(410) == 0
    assert len(bench.all("HOME_POSITION")) == before + 1
    assert bench.command(512, 9999.0) == 4


@pytest.mark.parametrize(("frame", "altitude"), [(0, 599.09), (5, 599.09), (3, 15.0), (6, 15.0)])
def test_global_setpoints_are_flown_in_four_frames(frame, altitude):
    bench = flying()
    message = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, 0xDF8, *HOME, altitude, *(0.0,) * 8
    )
    bench.send(message)
    bench.run(15.0)
    assert bench.last("LOCAL_POSITION_NED").z == pytest.approx(-15.0, abs=0.2)


def test_a_global_setpoint_in_another_frame_stops():
    bench = flying()
    bench.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 1, 0xDF8, *HOME, 15.0, *(0.0,) * 8
        )
    )
    assert bench.vehicle.report()["setpoints_refused"] == 1


# -- faults and robustness -----------------------------------------------------------------


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"origin_move"}))
def test_every_kind_of_fault_runs_in_flight_and_ends(kind):
    bench = flying(faults=[f"from=offboard,t=1,for=1,kind={kind}"],
                   targets=["kind=static,at=5:5:5"])  # fmt: skip
    bench.run(4.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert any(kind in line for line in bench.vehicle.take_log())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("kind=origin_move", "cannot befall"), ("kind=rc_takeover,mode=posctl", "mode must be one")],
)
def test_faults_of_the_other_autopilot_are_refused(text, complaint):
    with pytest.raises(UsageError, match=complaint):
        parse_fault(text, links=1, targets=[], personality=ARDUPILOT)


def test_the_same_seed_gives_the_same_bytes():
    def fly():
        bench = flying(faults=["kind=loss,from=arm,t=2"], seed=3)
        return [received.packet for received in bench.received]

    assert fly() == fly()


@pytest.mark.parametrize("seed", range(3))
def test_no_message_whatever_it_holds_stops_the_vehicle(seed):
    rng = np.random.default_rng(seed)
    bench = flying(ground_links=(False, True), seed=seed)
    handled = [75, 76, 84, 86, 11, 69, 23, 20, 21, 43, 66, 110, 111, 4]
    for _ in range(1000):
        number = int(rng.choice(handled))
        message_class = mavlink.mavlink_map[number]
        payload = rng.integers(0, 256, message_class.unpacker.size, dtype="uint8").tobytes()
        codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        message = mavlink.MAVLink_message(number, message_class.msgname)
        fields = list(message_class.unpacker.unpack(payload))
        for name in ("target_system", "target_component", "target"):
            if name in message_class.ordered_fieldnames:
                fields[message_class.ordered_fieldnames.index(name)] = 1
        payload = message_class.unpacker.pack(*fields)
        packet = message._pack(codec, message_class.crc_extra, payload)
        bench.vehicle.receive(int(rng.integers(2)), packet)
        bench.run(0.01)
    bench.run(2.0)
    assert math.isfinite(bench.vehicle.autopilot.body.position_m[0])


@pytest.mark.parametrize("number", [511, 512, 176, 400, 22, 192, 410, 520])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3e38, -1.0])
def test_commands_with_silly_values_get_an_answer(number, value):
    bench = booted()
    assert bench.command(number, *(value,) * 7) in range(5)
    bench.run(1.0)


# -- intervals, missions, restart ------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked_us", "got_us"),
    [(50_000, 50_000), (1, 1000), (-2, 1000), (1_500, 1000), (3e8, 60_000_000), (-1, -1), (0, -1)],
    ids=["20 Hz", "1 us", "-2 us", "1.5 ms", "5 minutes", "off", "default"],
)
def test_intervals_are_whole_milliseconds_up_to_a_minute(asked_us, got_us):
    bench = booted()
    assert bench.command(511, 30, asked_us) == 0
    assert bench.command(510, 30) == 0
    answer = bench.last("MESSAGE_INTERVAL")
    assert (answer.message_id, answer.interval_us) == (30, got_us)


def test_unknown_messages_are_refused_with_a_text():
    bench = booted()
    assert bench.command(511, 436, 1e6) == 2
    assert bench.texts()[-1] == "No ap_message for mavlink id (436)"
    assert bench.command(510, 436) == 4
    assert bench.last("MESSAGE_INTERVAL").interval_us == 0
    assert bench.command(512, 436) == 4


def test_an_upload_of_no_items_clears_the_mission():
    bench = booted()
    for count, answer in ((0, 0), (3, 3)):
        bench.send(mavlink.MAVLink_mission_count_message(1, 1, count, 0))
        assert bench.last("MISSION_ACK").type == answer


def test_it_restarts_when_asked_on_the_ground():
    bench = booted()
    assert bench.command(246, 2) == 3
    assert bench.command(511, 32, 50_000) == 0
    bench.run(1.0)
    before = bench.last("LOCAL_POSITION_NED").time_boot_ms
    assert bench.command(246, 1) == 0
    bench.run(1.0)
    restarted = bench.time_s - 0.9
    assert not bench.all("LOCAL_POSITION_NED", since_s=restarted)  # what was asked is forgotten
    bench.run(1.0)
    assert bench.command(511, 32, 50_000) == 0
    bench.run(0.5)
    assert bench.last("LOCAL_POSITION_NED").time_boot_ms < before
    assert bench.command(176, 1.0, GUIDED) == 0
    assert bench.command(400, 1.0) == 0
    assert bench.command(246, 1) == 4
