"""A signed flight: the mock behind a wire whose other end is signed by pymavlink."""

from datetime import UTC, datetime

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion import clock
from companion.errors import LinkLostError
from companion.vehicle import EventKind, FlightMode, RequestKind, RequestState, SystemStatus

KEY = bytes(range(100, 132))
NORTH = np.array((2.0, 0.0, 0.0))


def signer(key):
    """Return an end of pymavlink's that signs with ``key``, by the clock."""
    since_2015_s = (clock.utc_now() - datetime(2015, 1, 1, tzinfo=UTC)).total_seconds()
    mavlink = dialect.MAVLink(None)
    mavlink.signing.secret_key = key
    mavlink.signing.sign_outgoing = True
    mavlink.signing.timestamp = int(since_2015_s * 1e5)
    return mavlink


class SignedEnd:
    """Signs what the mock says and checks what the companion says, by pymavlink alone."""

    def __init__(self, wire, key=KEY):
        self._plain = dialect.MAVLink(None)
        self._signer = signer(key)
        self._checker = signer(key)
        self._wire = wire
        self.kept = []
        self.refused = 0
        wire.to_companion, wire.to_vehicle = self._sign, self._check

    def replay(self):
        """Say again, bit for bit, what the vehicle has said before."""
        self._wire.send(self.kept[0])

    def inject(self, message, *, system_id=1, component_id=1, mavlink=None):
        """Let somebody say ``message`` on the vehicle's port: unsigned unless told how."""
        mavlink = mavlink or dialect.MAVLink(None)
        mavlink.srcSystem, mavlink.srcComponent = system_id, component_id
        self._wire.send(message.pack(mavlink))

    def _sign(self, data):
        try:
            message = self._plain.decode(bytearray(data))
        except dialect.MAVError:
            return None
        if message.get_type().startswith("UNKNOWN"):
            return None
        self._signer.srcSystem = message.get_srcSystem()
        self._signer.srcComponent = message.get_srcComponent()
        self._signer.seq = message.get_seq()
        frame = message.pack(self._signer)
        if message.get_type() == "HEARTBEAT":
            self.kept.append(frame)
        return frame

    def _check(self, data):
        try:
            message = self._checker.decode(bytearray(data))
        except dialect.MAVError:
            self.refused += 1
            return None
        assert data[2] == 1
        self._plain.srcSystem, self._plain.srcComponent = data[5], data[6]
        return message.pack(self._plain)


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex())
    path.chmod(0o600)
    return path


@pytest.fixture
def signed(port, mock, linked, relay, key_file):
    """Return a pilot on a signed mock, and the signed end."""

    def start(*options, key=KEY, **link_options):
        listening = port()
        wire = relay(listening)
        end = SignedEnd(wire, key)
        mock("--connect", f"udpout:127.0.0.1:{wire.port}", *options)
        return linked(f"udpin:127.0.0.1:{listening}", signing_key=key_file, **link_options), end

    return start


@pytest.mark.parametrize("backend", ["pymavlink", "mavsdk"])
def test_a_signed_flight(signed, backend):
    pilot, end = signed(backend=backend)
    pilot.fly(pilot.ready)
    pilot.get_external()
    pilot.fly(lambda: pilot.state.position_ned_m[0] > 2.0, velocity=NORTH)
    assert end.refused == 0
    assert pilot.vehicle.stats().packets_refused == 0
    assert pilot.ask(RequestKind.HOLD) is RequestState.CONFIRMED


def test_nobody_without_the_key_is_heard(signed):
    pilot, end = signed(target_sysids=(42,))
    pilot.fly(pilot.ready)
    pilot.get_external()
    flying = pilot.state
    stranger = signer(bytes(32))
    rtl = dialect.MAVLink_heartbeat_message(2, 12, 0x9D, 0x05040000, SystemStatus.CRITICAL, 3)
    here = dialect.MAVLink_global_position_int_message(
        1, 473977420, 85455940, 500_000, 10_000, 0, 0, 0, 0
    )
    go_there = dialect.MAVLink_command_int_message(
        1, 191, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0, 473977420, 85455940, 500
    )
    steer = dialect.MAVLink_set_position_target_local_ned_message(
        1, 1, 1, 1, 3527, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0
    )
    for mavlink in (None, stranger):
        end.inject(rtl, mavlink=mavlink)
        end.inject(here, system_id=42, mavlink=mavlink)
        end.inject(go_there, system_id=255, component_id=190, mavlink=mavlink)
        end.inject(steer, system_id=255, component_id=190, mavlink=mavlink)
    end.replay()
    pilot.fly(lambda: pilot.vehicle.stats().packets_refused >= 9, velocity=np.zeros(3))
    assert pilot.vehicle.stats().packets_refused == 9
    assert pilot.state.mode is FlightMode.EXTERNAL
    assert pilot.state.system_status is flying.system_status
    assert not pilot.vehicle.targets()
    pilot.fly(lambda: pilot.heard(EventKind.LINK_ERROR), velocity=np.zeros(3))
    assert {event.kind for event in pilot.events} <= {
        EventKind.STATUS_TEXT,
        EventKind.LINK_ERROR,
    }
    assert end.refused == 0

    holder = signer(KEY)
    end.inject(here, system_id=42, mavlink=holder)
    end.inject(go_there, system_id=255, component_id=190, mavlink=holder)
    pilot.fly(lambda: 42 in pilot.vehicle.targets() and pilot.heard(EventKind.COMMAND))


def test_another_key_is_another_vehicle(signed):
    with pytest.raises(LinkLostError, match="signed with another key"):
        signed(key=bytes(32))
