import io

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from companion.session.tlog import TlogWriter, read_tlog

UTC_US = 1_795_356_187_000_000


def test_ground_stations_read_it(tmp_path):
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    path = tmp_path / "flight.tlog"
    with path.open("wb") as file:
        writer = TlogWriter(file, UTC_US)
        for index in range(100):
            message = common.MAVLink_local_position_ned_message(index, 1.0, 2.0, -3.0, 0.1, 0.2, 0)
            writer.write(index * 0.05, message.pack(sender, force_mavlink1=index % 2 == 0))
            sender.seq = (sender.seq + 1) % 256
    log = mavutil.mavlink_connection(str(path))
    messages = []
    while (message := log.recv_match(type="LOCAL_POSITION_NED")) is not None:
        messages.append(message)
    log.close()
    assert [message.time_boot_ms for message in messages] == list(range(100))
    assert messages[-1]._timestamp == pytest.approx(UTC_US / 1e6 + 99 * 0.05)


def test_what_was_written_is_read_back_up_to_a_cut():
    """Frames of MAVLink 1 and 2, signed and unsigned, cut off anywhere."""
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    message = common.MAVLink_local_position_ned_message(1, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3)
    plain = message.pack(sender)
    signed = plain[:2] + b"\x01" + plain[3:] + bytes(13)
    frames = [plain, message.pack(sender, force_mavlink1=True), signed, plain]
    file = io.BytesIO()
    writer = TlogWriter(file, UTC_US)
    ends = [0]
    for index, frame in enumerate(frames):
        writer.write(index * 0.25, frame)
        ends.append(file.tell())
    data = file.getvalue()
    entries = [(UTC_US + index * 250_000, frame) for index, frame in enumerate(frames)]
    for size in range(len(data) + 1):
        whole = sum(end <= size for end in ends[1:])
        assert read_tlog(data[:size]) == entries[:whole]
