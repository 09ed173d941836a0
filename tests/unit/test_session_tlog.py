import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from companion.session.tlog import TlogWriter

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
