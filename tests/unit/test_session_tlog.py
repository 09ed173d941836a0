import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from companion.session.tlog import FrameSplitter, TlogWriter

UTC_US = 1_795_356_187_000_000


def packets(count, *, signed=False, version=2):
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    if signed:
        sender.signing.secret_key = b"k" * 32
        sender.signing.sign_outgoing = True
        sender.signing.timestamp = 1
    made = []
    for index in range(count):
        message = common.MAVLink_local_position_ned_message(index, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3)
        made.append(bytes(message.pack(sender, force_mavlink1=version == 1)))
        sender.seq = (sender.seq + 1) % 256
    return made


@pytest.mark.parametrize(
    "sent", [packets(5), packets(5, signed=True), packets(5, version=1)], ids=["2", "signed", "1"]
)
@given(portion=st.integers(min_value=1, max_value=200))
def test_frames_come_out_whole_from_any_portions(sent, portion):
    stream = b"".join(sent)
    splitter = FrameSplitter()
    received = []
    for start in range(0, len(stream), portion):
        received += splitter.feed(stream[start : start + portion])
    assert received == sent


def test_bytes_between_frames_are_skipped():
    first, second = packets(2)
    assert FrameSplitter().feed(b"noise" + first + b"\x00\x01" + second) == [first, second]


def test_directions_do_not_mix():
    (frame,) = packets(1)
    file = io.BytesIO()
    writer = TlogWriter(file)
    writer.write(frame[:5], sent=False, utc_us=1)
    writer.write(frame, sent=True, utc_us=2)
    writer.write(frame[5:], sent=False, utc_us=3)
    assert file.getvalue() == b"".join(time.to_bytes(8, "big") + frame for time in (2, 3))


def test_ground_stations_read_it(tmp_path):
    path = tmp_path / "flight.tlog"
    with path.open("wb") as file:
        writer = TlogWriter(file)
        for index, frame in enumerate(packets(100)):
            writer.write(frame, sent=index % 2 == 0, utc_us=UTC_US + index * 50_000)
    log = mavutil.mavlink_connection(str(path))
    messages = []
    while (message := log.recv_match(type="LOCAL_POSITION_NED")) is not None:
        messages.append(message)
    log.close()
    assert [message.time_boot_ms for message in messages] == list(range(100))
    assert messages[-1]._timestamp == pytest.approx(UTC_US / 1e6 + 99 * 0.05)
