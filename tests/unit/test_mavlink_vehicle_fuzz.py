"""Whatever well-formed packets say, the link neither raises nor makes up numbers."""

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

HEARD = frozenset(
    (
        "HEARTBEAT",
        "SYS_STATUS",
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "GLOBAL_POSITION_INT",
        "EXTENDED_SYS_STATE",
        "ESTIMATOR_STATUS",
        "EKF_STATUS_REPORT",
        "ODOMETRY",
        "GPS_GLOBAL_ORIGIN",
        "HOME_POSITION",
        "AUTOPILOT_VERSION",
        "STATUSTEXT",
        "COMMAND_ACK",
        "TIMESYNC",
        "PARAM_VALUE",
        "FOLLOW_TARGET",
        "COMMAND_LONG",
        "COMMAND_INT",
        "SET_POSITION_TARGET_LOCAL_NED",
        "SET_POSITION_TARGET_GLOBAL_INT",
        "SET_ATTITUDE_TARGET",
    )
)
IDS = sorted(key for key, kind in dialect.mavlink_map.items() if kind.msgname in HEARD)

FLOATS = (0.0, np.nan, np.inf, -np.inf, 1e38)
SPECIAL = (*(struct.pack("<f", value) for value in FLOATS), b"\xff" * 4, b"\x00\x00\x00\x80")


@st.composite
def packets(draw):
    """A packet of a message that the link looks into, with any payload and a right checksum."""
    message_id = draw(st.sampled_from(IDS))
    kind = dialect.mavlink_map[message_id]
    size = kind.unpacker.size
    payload = bytearray(draw(st.binary(min_size=size, max_size=size)))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, max(0, size - 4)))
        payload[at : at + 4] = draw(st.sampled_from(SPECIAL))
    payload = bytes(payload[: draw(st.integers(1, size))])
    source = draw(st.sampled_from([(1, 1), (1, 1), (42, 1), (255, 190), (1, 191)]))
    header = bytes((len(payload), 0, 0, draw(st.integers(0, 255)), *source))
    body = header + message_id.to_bytes(3, "little") + payload
    crc = dialect.x25crc(body + bytes((kind.crc_extra,))).crc
    return b"\xfd" + body + struct.pack("<H", crc)


@pytest.mark.parametrize("autopilot", [3, 12])
def test_any_payload(bench, autopilot):
    vehicle = bench.attach(autopilot=autopilot, target_sysids=(42,))
    bench.flying()

    @settings(
        max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
    )
    @given(st.lists(packets(), min_size=1, max_size=8))
    def hear(heard):
        bad = vehicle.stats().bytes_bad
        for frame in heard:
            bench.transport.deliver(frame)
        bench.run(0.05)
        assert vehicle.stats().bytes_bad == bad
        vehicle.take_events()
        state = vehicle.state()
        if state is not None:
            assert np.isfinite(state.position_ned_m).all()
            assert np.isfinite(state.velocity_ned_mps).all()
            assert np.isfinite(state.attitude_rad).all()
            assert state.battery_fraction is None or 0.0 <= state.battery_fraction <= 1.0
        for report in vehicle.targets().values():
            assert abs(report.position.latitude_deg) <= 90.0
            assert np.isfinite(report.position.altitude_m)
        bench.transport.sent.clear()

    hear()
