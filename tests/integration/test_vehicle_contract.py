"""One contract for every vehicle and both backends.

Against the mock, and against a real autopilot or a simulator of one where COMPANION_TEST_CONNECT
holds its URL: that one is armed and flown 8 m high.
"""

import itertools
import os
import sys

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion import clock
from companion.errors import AmbiguousVehicleError, UsageError
from companion.link.opening import check_backend
from companion.vehicle import EventKind, FlightMode, RequestKind, RequestState, SystemStatus

REAL_URL = os.environ.get("COMPANION_TEST_CONNECT", "")
HOLD_STILL = np.zeros(3)
NORTH = np.array((2.0, 0.0, 0.0))
BACKENDS = [
    "pymavlink",
    pytest.param(
        "mavsdk",
        marks=pytest.mark.skipif(
            sys.platform == "darwin", reason="mavsdk has no wheel for this system"
        ),
    ),
]
VEHICLES = [
    "px4",
    "ardupilot",
    pytest.param(
        "real", marks=pytest.mark.skipif(not REAL_URL, reason="COMPANION_TEST_CONNECT is not set")
    ),
]
every_backend = pytest.mark.parametrize("backend", BACKENDS)


def of_us(frames):
    """Return what the companion said, decoded by pymavlink."""
    reader = dialect.MAVLink(None)
    return [reader.decode(bytearray(frame)) for frame in frames]


@pytest.fixture
def vehicle(port, mock, linked, relay):
    """Return a pilot on a vehicle that is ready, and what the companion has put on the wire."""

    def start(name, backend, *options):
        sent = []
        if name == "real":
            pilot = linked(
                REAL_URL,
                backend=backend,
                tap=lambda ours, _time_s, frame: sent.append(frame) if ours else None,
            )
        else:
            listening = port()
            wire = relay(listening)
            sent = wire.of_companion
            mock("--connect", f"udpout:127.0.0.1:{wire.port}", *options, autopilot=name)
            pilot = linked(f"udpin:127.0.0.1:{listening}", backend=backend)
        # ArduCopter's checks pass while its estimator still only predicts the position.
        pilot.fly(lambda: pilot.ready() and pilot.state.position_valid, timeout_s=120.0)
        return pilot, sent

    return start


@every_backend
@pytest.mark.parametrize("name", VEHICLES)
def test_a_flight(vehicle, name, backend):
    pilot, sent = vehicle(name, backend)
    info = pilot.vehicle.info
    assert info.autopilot in ("px4", "ardupilot")
    assert info.version
    assert pilot.state.position_valid
    pilot.get_external()

    start_m = pilot.state.position_ned_m
    pilot.fly(lambda: pilot.state.position_ned_m[0] > start_m[0] + 10.0, velocity=NORTH)
    assert pilot.state.velocity_ned_mps[0] == pytest.approx(2.0, rel=0.25)
    # Velocity alone lets PX4's own simulator drift: 1.04 m on these 10.
    aside_m = 1.5 if name == "real" else 1.0
    assert pilot.state.position_ned_m[1] == pytest.approx(start_m[1], abs=aside_m)

    assert pilot.ask(RequestKind.HOLD, velocity=HOLD_STILL) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.state.mode is FlightMode.HOLD)
    assert pilot.ask(RequestKind.LAND) is RequestState.CONFIRMED
    pilot.fly(lambda: not pilot.state.armed, timeout_s=60.0)

    said = of_us(sent)
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in said} == {
        (info.system_id, 191)
    }
    heartbeats = [message for message in said if message.get_type() == "HEARTBEAT"]
    assert {(message.type, message.autopilot) for message in heartbeats} == {(18, 8)}
    seen = {message.system_status for message in heartbeats}
    if name == "real":  # who calls it by TCP speaks first, while it looks for the vehicle
        seen.discard(SystemStatus.BOOT)
    assert seen == {SystemStatus.ACTIVE}
    setpoints = [message for message in said if "SET_POSITION" in message.get_type()]
    assert len(setpoints) == pilot.vehicle.stats().setpoints_sent
    assert {message.type_mask for message in setpoints} == {3527}
    assert {message.get_type() for message in said} <= {
        "HEARTBEAT", "COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED", "TIMESYNC",
    }  # fmt: skip
    addressed = {message.target_system for message in said if hasattr(message, "target_system")}
    assert addressed == {info.system_id}
    sequences = [frame[4] for frame in sent]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(sequences))
    stats = pilot.vehicle.stats()
    assert stats.bytes_bad == 0
    # A real link may lose some: one flight on PX4's simulator lost 3.
    assert stats.loss_percent < (1.0 if name == "real" else 1e-9)


@every_backend
def test_one_call_is_one_frame_and_silence_is_silence(vehicle, backend):
    pilot, sent = vehicle("px4", backend)
    pilot.get_external()
    for velocity in (NORTH, -NORTH, np.array((0.5, -0.25, 0.125))):
        pilot.fly(lambda: True)
        pilot.vehicle.wait_until(pilot.vehicle.now_s() + 0.2)
        before = len(sent)
        pilot.vehicle.send_velocity(velocity)
        clock.sleep_s(0.2)
        # Answers to TIMESYNC may be among them; setpoints are what must not be repeated.
        frames = of_us(sent[before:])
        (message,) = [frame for frame in frames if "SET_POSITION" in frame.get_type()]
        assert [message.vx, message.vy, message.vz] == velocity.tolist()

    before = len(sent)
    clock.sleep_s(2.5)  # the caller hangs: nobody speaks for it, not even a heartbeat
    assert sent[before:] == []
    pilot.fly(lambda: pilot.state.mode is not FlightMode.EXTERNAL)
    assert pilot.state.system_status is SystemStatus.CRITICAL
    assert not any("SET_POSITION" in message.get_type() for message in of_us(sent[before:]))
    assert pilot.ask(RequestKind.HOLD) is RequestState.CONFIRMED

    pilot.vehicle.close()
    clock.sleep_s(0.2)  # what was on its way arrives
    before = len(sent)
    clock.sleep_s(1.5)
    assert sent[before:] == []


@every_backend
def test_a_takeover_shows(vehicle, backend):
    options = ("--radio", "--fault", "from=offboard,t=2,kind=rc_takeover")
    pilot, _ = vehicle("px4", backend, *options)
    pilot.get_external()
    pilot.fly(lambda: pilot.state.mode is not FlightMode.EXTERNAL, velocity=HOLD_STILL)
    assert pilot.state.mode is FlightMode.OTHER
    assert pilot.state.mode_name == "POSCTL"


@every_backend
def test_a_second_companion_shows(vehicle, backend):
    pilot, _ = vehicle("px4", backend, "--fault", "t=1,kind=second_companion")
    pilot.fly(lambda: pilot.heard(EventKind.FOREIGN_SETPOINT))
    told = next(event for event in pilot.events if event.kind is EventKind.FOREIGN_SETPOINT)
    assert "1/192" in told.text


@every_backend
def test_a_refusal_is_told(vehicle, backend):
    pilot, _ = vehicle("px4", backend)
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    assert pilot.ask(RequestKind.EXTERNAL) is RequestState.REJECTED
    assert "TEMPORARILY_REJECTED" in pilot.vehicle.request_status().detail
    assert pilot.vehicle.read_param("COM_OF_LOSS_T") == 1.0
    assert isinstance(pilot.vehicle.read_param("COM_RC_IN_MODE"), int)


@every_backend
def test_two_vehicles_need_a_choice(port, mock, linked, backend):
    listening = port()
    mock(
        "--connect", f"udpout:127.0.0.1:{listening}",
        "--target", "kind=circle,sysid=42,autopilot=px4",
    )  # fmt: skip
    url = f"udpin:127.0.0.1:{listening}"
    with pytest.raises(AmbiguousVehicleError, match="1, 42"):
        linked(url, backend=backend)
    pilot = linked(url, backend=backend, vehicle_sysid=1, target_sysids=(42,))
    pilot.fly(lambda: pilot.ready() and 42 in pilot.vehicle.targets())
    assert pilot.vehicle.info.system_id == 1
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED


def test_a_backend_that_is_not_installed():
    with pytest.raises(UsageError, match="pip install"):
        check_backend("no_such_backend")
