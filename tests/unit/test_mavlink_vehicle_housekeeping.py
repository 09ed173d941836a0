"""What the link asks the vehicle for by itself, and parameters: read, never written."""

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.vehicle import RequestKind


def asked_for(bench):
    return [int(message.param1) for message in bench.commands(dialect.MAV_CMD_REQUEST_MESSAGE)]


def test_origin_home_and_version_are_asked_for_until_they_come(bench):
    bench.attach()
    bench.run(3.5)
    assert asked_for(bench).count(49) >= 4
    bench.origin()
    bench.autopilot.send(
        dialect.MAVLink_home_position_message(
            473977420, 85455940, 489400, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0
        )
    )
    bench.autopilot.send(
        dialect.MAVLink_autopilot_version_message(
            0, 0x040603FF, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0
        )
    )
    bench.run(1.0)
    before = len(asked_for(bench))
    bench.run(5.0)
    assert len(asked_for(bench)) == before
    assert bench.vehicle.info.version == "4.6.3"


@pytest.mark.parametrize(
    ("packed", "words"),
    [(0x01120080, "1.18.0 beta"), (0x040603FF, "4.6.3"), (0x010F00C0, "1.15.0 rc"),
     (0x01100000, "1.16.0 dev"), (0x01100040, "1.16.0 alpha")],
)  # fmt: skip
def test_versions_in_words(bench, packed, words):
    bench.attach()
    bench.autopilot.send(
        dialect.MAVLink_autopilot_version_message(
            0, packed, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0
        )
    )
    bench.run()
    assert bench.vehicle.info.version == words


def intervals(bench):
    return [
        (int(message.param1), message.param2)
        for message in bench.commands(dialect.MAV_CMD_SET_MESSAGE_INTERVAL)
    ]


def test_streams_that_are_missing_are_asked_for(ardupilot):
    ardupilot.run(3.0)
    asked = dict(intervals(ardupilot))
    assert set(asked) == {32, 33, 30, 1, 245, 193}
    assert asked[32] == pytest.approx(1e6 / 30)


def positions_flow(bench, duration_s):
    end_s = bench.transport.now_s + duration_s
    while bench.transport.now_s < end_s:
        bench.position()
        bench.run(0.03)


def test_streams_that_flow_are_left_alone(ardupilot):
    positions_flow(ardupilot, 5.0)  # the first window lies partly before them
    ardupilot.transport.sent.clear()
    positions_flow(ardupilot, 20.0)
    assert set(dict(intervals(ardupilot))) == {30, 33, 1, 245, 193}


def test_a_stream_that_others_slowed_is_asked_for_again_but_not_in_a_hurry(ardupilot):
    positions_flow(ardupilot, 10.0)
    ardupilot.transport.sent.clear()
    ardupilot.run(20.0)
    times = [message_id for message_id, _ in intervals(ardupilot)].count(32)
    assert 3 <= times <= 4


# -- parameters --------------------------------------------------------------------------------


def param_value(bench, name, raw, kind):
    """Send PARAM_VALUE with these four bytes; pymavlink would lose some on the way."""
    frame = bytearray(
        bench.autopilot.pack(dialect.MAVLink_param_value_message(name, 1.0, kind, 1, 0))
    )
    frame[10:14] = raw
    crc = dialect.x25crc(
        bytes(frame[1:-2]) + bytes((dialect.MAVLink_param_value_message.crc_extra,))
    )
    frame[-2:] = struct.pack("<H", crc.crc)
    bench.transport.deliver(bytes(frame), after_s=0.05)


def answer_params(bench, values):
    def answer(message):
        if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in values:
            param_value(bench, message.param_id.encode(), *values[message.param_id])

    bench.transport.on_sent = answer


def test_parameters_of_px4_are_read_bytewise(px4):
    answer_params(
        px4,
        {
            "COM_OF_LOSS_T": (struct.pack("<f", 1.0), 9),
            "COM_FLTMODE1": (struct.pack("<i", -1), 6),
            "SIGNALLING": (struct.pack("<i", -5000000), 6),
        },
    )
    assert px4.vehicle.read_param("COM_OF_LOSS_T") == 1.0
    assert px4.vehicle.read_param("COM_FLTMODE1") == -1
    assert px4.vehicle.read_param("SIGNALLING") == -5000000


def test_parameters_of_ardupilot_are_cast(ardupilot):
    answer_params(ardupilot, {"GUID_TIMEOUT": (struct.pack("<f", 3.0), 9),
                              "FS_GCS_ENABLE": (struct.pack("<f", 1.0), 2)})  # fmt: skip
    assert ardupilot.vehicle.read_param("GUID_TIMEOUT") == 3.0
    value = ardupilot.vehicle.read_param("FS_GCS_ENABLE")
    assert (value, type(value)) == (1, int)


def test_an_unknown_parameter_is_none_in_time(px4):
    start_s = px4.transport.now_s
    assert px4.vehicle.read_param("NO_SUCH_THING", timeout_s=2.0) is None
    assert px4.transport.now_s - start_s == pytest.approx(2.0)
    assert len(px4.transport.sent_of("PARAM_REQUEST_READ")) == 3


def test_no_parameter_is_ever_written(px4):
    for kind in RequestKind:
        px4.vehicle.request(kind, altitude_m=10.0)
        px4.run(5.0)
    px4.vehicle.read_param("COM_OF_LOSS_T")
    names = {message.get_type() for message in px4.transport.sent}
    assert names == {"COMMAND_LONG", "PARAM_REQUEST_READ"}
