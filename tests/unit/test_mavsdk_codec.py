"""Two libraries, one meaning: what MAVSDK reads and writes is what pymavlink does."""

import math
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

pytest.importorskip("mavsdk", reason="mavsdk is not installed")

from companion.errors import LinkLostError
from companion.link import messages
from companion.link.codec import Codec, Parser, Received
from companion.link.mavsdk import MavsdkCodec
from companion.vehicle import SystemStatus

READ = [
    "ATTITUDE", "AUTOPILOT_VERSION", "BATTERY_STATUS", "COMMAND_ACK", "COMMAND_INT",
    "COMMAND_LONG", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "EXTENDED_SYS_STATE",
    "FOLLOW_TARGET", "GLOBAL_POSITION_INT", "GPS_GLOBAL_ORIGIN", "HEARTBEAT", "HOME_POSITION",
    "LOCAL_POSITION_NED", "ODOMETRY", "PARAM_VALUE", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED", "STATUSTEXT", "SYS_STATUS",
    "TIMESYNC",
]  # fmt: skip
"""All that the link has ever decoded."""

HEARTBEAT = dialect.MAVLink_heartbeat_message(2, 12, 0x1D, 7, 3, 3)

several = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def codec():
    codec = MavsdkCodec(1, 191)
    codec.become(7)
    for system_id in (7, 255):
        assert codec.decode(packet(HEARTBEAT.pack(dialect.MAVLink(None, system_id, 1))))
    yield codec
    codec.close()


def packet(frame):
    (received,) = Parser().receive(frame, 0.0)
    return received


def message_class(name):
    return next(each for each in dialect.mavlink_map.values() if each.msgname == name)


def same(ours, theirs):
    if isinstance(theirs, list | tuple):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(theirs, float) and not math.isfinite(theirs):
        return math.isnan(ours)
    return ours == theirs


def printable(frame, kind):
    """Make the characters of a frame ASCII: libraries differ in what they put for others."""
    return bytes(byte & 0x7F for byte in frame) if "char" in kind.fieldtypes else frame


@pytest.mark.parametrize("name", READ)
@several
@given(data=st.data())
def test_both_read_the_same(codec, name, data):
    kind = message_class(name)
    size = kind.unpacker.size
    payload = printable(data.draw(st.binary(max_size=size)), kind)
    header = bytes((len(payload), 0, 0, 7, 3, 4)) + kind.id.to_bytes(3, "little")
    crc = dialect.x25crc(header + payload + bytes((kind.crc_extra,))).crc
    frame = b"\xfd" + header + payload + crc.to_bytes(2, "little")
    received = packet(frame)
    theirs = Codec(9, 9).decode(received)
    ours = codec.decode(received)
    if ours is None:
        assert theirs.target_system not in (0, codec.system_id)
        return
    assert (ours.get_type(), ours.get_msgId()) == (name, kind.id)
    for key in theirs.fieldnames:
        assert same(getattr(ours, key), getattr(theirs, key)), key


@pytest.mark.parametrize("flight", ["px4_short_flight_companion_30s", "ap_short_flight_companion"])
def test_both_read_the_same_of_a_recorded_flight(recorded_flight, flight):
    codec = MavsdkCodec(1, 191)
    plain = Codec(1, 191)
    count = 0
    for _, frame in recorded_flight(flight):
        received = packet(frame)
        kind = dialect.mavlink_map.get(received.message_id)
        if kind is None or kind.msgname not in READ:
            continue
        count += 1
        ours, theirs = codec.decode(received), plain.decode(received)
        if ours is None:
            assert theirs.target_system not in (0, 1)
            continue
        for key in theirs.fieldnames:
            assert same(getattr(ours, key), getattr(theirs, key)), (kind.msgname, key)
    codec.close()
    assert count > 500


SENT = [
    messages.heartbeat(SystemStatus.ACTIVE),
    messages.request_message(7, 148),
    messages.set_message_interval(7, 32, 30.0),
    messages.command_ack(192, 0, 255, 190),
    messages.own_version(),
    messages.timesync_reply(-(2**62), 2**63 - 1),
    messages.read_param(7, "COM_OF_LOSS_T"),
    messages.read_param(7, "EXACTLY_16_CHARS"),
    dialect.MAVLink_command_long_message(7, 1, 22, 0, 0, 0, 0, *[math.nan] * 3, 499.4),
    dialect.MAVLink_statustext_message(6, b"on the way"),
    dialect.MAVLink_statustext_message(6, b"y" * 50, 65535, 3),
    dialect.MAVLink_statustext_message(6, b""),
]


@pytest.mark.parametrize("index", range(len(SENT)))
def test_both_write_the_same(codec, index):
    message = SENT[index]
    plain = Codec(7, 191)
    sequence = codec.encode(message)[4]
    assert codec.encode(message)[4] == (sequence + 1) % 256
    assert codec.encode(message)[5:-2] == plain.encode(message)[5:-2]


@several
@given(
    st.tuples(*[st.floats(-1000, 1000, width=32)] * 3),
    st.none() | st.floats(-math.pi, math.pi),
    st.integers(0, 2**32 - 1),
)
def test_setpoints_survive_whole(codec, velocity_mps, yaw_rad, time_boot_ms):
    import numpy as np

    message = messages.velocity_setpoint(
        7, np.array(velocity_mps), yaw_rad, time_boot_ms=time_boot_ms
    )
    received = packet(codec.encode(message))
    read = Codec(9, 9).decode(received)
    assert (read.vx, read.vy, read.vz) == velocity_mps
    assert (read.target_system, read.target_component, read.time_boot_ms) == (7, 1, time_boot_ms)
    assert read.type_mask == (3527 if yaw_rad is None else 2503)


def test_signed_and_old_frames_are_read(codec):
    signer = dialect.MAVLink(None, 1, 1)
    signer.signing.secret_key = bytes(32)
    signer.signing.sign_outgoing = True
    for frame in (HEARTBEAT.pack(signer), HEARTBEAT.pack(signer, force_mavlink1=True)):
        received = packet(frame)
        assert codec.decode(received).custom_mode == 7


def test_others_who_steer_our_vehicle_are_read(codec):
    setpoint = dialect.MAVLink_set_position_target_local_ned_message(
        1, 7, 1, 1, 3527, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0
    )
    for sender in ((7, 191), (7, 192), (255, 190)):
        frame = setpoint.pack(dialect.MAVLink(None, *sender))
        assert codec.decode(packet(frame)).target_system == 7


def test_nothing_is_printed(codec, capfd):
    text = dialect.MAVLink_statustext_message(2, b'\xff\xfe caf\xe9 "\n\t\x01')
    received = packet(text.pack(dialect.MAVLink(None, 7, 1)))
    assert "caf" in codec.decode(received).text
    codec.encode(messages.heartbeat(SystemStatus.ACTIVE))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("length", [0, 100, 255])
def test_a_length_that_lies_holds_nobody_up(codec, length):
    frame = bytearray(HEARTBEAT.pack(dialect.MAVLink(None, 7, 1)))
    frame[1] = length
    assert codec.decode(Received(0.0, 7, 1, 0, bytes(frame))) is None
    assert codec.decode(packet(HEARTBEAT.pack(dialect.MAVLink(None, 7, 1)))).custom_mode == 7


def test_what_nobody_knows_is_nothing(codec):
    header = bytes((3, 0, 0, 0, 1, 1)) + (410).to_bytes(3, "little")
    crc = dialect.x25crc(header + b"abc" + bytes((160,))).crc
    received = packet(b"\xfd" + header + b"abc" + crc.to_bytes(2, "little"))
    assert codec.decode(received) is None


def test_what_mavsdk_does_not_send_is_an_error(codec):
    class Strange(dialect.MAVLink_heartbeat_message):
        def get_type(self):
            return "NO_SUCH_MESSAGE"

    with pytest.raises(LinkLostError, match="MAVSDK refuses to send NO_SUCH_MESSAGE"):
        codec.encode(Strange(18, 8, 0, 0, 3, 3))
    assert codec.encode(messages.heartbeat(SystemStatus.ACTIVE))


def test_two_at_once_and_a_third_after():
    first, second = MavsdkCodec(1, 191), MavsdkCodec(2, 191)
    received = packet(second.encode(messages.heartbeat(SystemStatus.ACTIVE)))
    assert first.decode(received).system_status == SystemStatus.ACTIVE
    first.close()
    first.close()
    assert second.decode(received) is not None
    second.close()
    third = MavsdkCodec(1, 191)
    assert third.decode(received) is not None
    third.close()


def test_it_is_loaded_only_when_chosen():
    check = "import sys, companion.run; sys.exit('mavsdk' in sys.modules)"
    subprocess.run([sys.executable, "-c", check], check=True)


@pytest.mark.parametrize("flags", [0x02, 0x03, 0x80, 0xFE])
def test_unknown_incompatibility_flags_never_reach_mavsdk(codec, flags):
    """MAVSDK waits for more of such a frame and is stuck: neither parser nor codec lets it in."""
    frame = bytearray(HEARTBEAT.pack(dialect.MAVLink(None, 7, 1)))
    frame[2] = flags
    crc = dialect.x25crc(bytes(frame[1:-2]) + bytes((HEARTBEAT.crc_extra,))).crc
    frame[-2:] = crc.to_bytes(2, "little")
    assert Parser().receive(bytes(frame), 0.0) == []
    asked = codec._marks
    assert codec.decode(Received(0.0, 7, 1, 0, bytes(frame))) is None
    assert codec._marks == asked


def test_the_library_is_loaded_before_the_link_is_open():
    """Its loading takes longer than the kernel keeps an autopilot's packets."""
    script = (
        "import sys; from companion.link import opening\n"
        "def opened(address): raise SystemExit('mavsdk' in sys.modules)\n"
        "opening.open_transport = opened\n"
        "opening.connect('udp:127.0.0.1:0', backend='mavsdk')"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 1
