"""The companion with ``--signing-key`` against a mock that signs by its own implementation."""

import numpy as np
import pytest

from companion.errors import LinkLostError
from companion.vehicle import FlightMode, RequestKind, RequestState

KEY = "0123456789abcdef" * 4
NORTH = np.array((2.0, 0.0, 0.0))


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY)
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_signed_flight(port, mock, linked, key_file, autopilot):
    listening = port()
    mock(
        "--connect", f"udpout:127.0.0.1:{listening}",
        "--signing-key", str(key_file),
        "--target", "kind=circle,sysid=42",
        autopilot=autopilot,
    )  # fmt: skip
    url = f"udpin:127.0.0.1:{listening}"
    pilot = linked(url, signing_key=key_file, vehicle_sysid=1, target_sysids=(42,))
    pilot.fly(lambda: pilot.ready() and 42 in pilot.vehicle.targets())
    pilot.get_external()
    start_m = pilot.state.position_ned_m[0]
    pilot.fly(lambda: pilot.state.position_ned_m[0] > start_m + 2.0, velocity=NORTH)
    assert pilot.ask(RequestKind.HOLD) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.state.mode is FlightMode.HOLD)
    assert pilot.vehicle.stats().packets_refused == 0


def test_without_the_key_nobody_talks(port, mock, linked, key_file, tmp_path):
    listening = port()
    other = tmp_path / "other"
    other.write_text("somebody else's")
    mock("--connect", f"udpout:127.0.0.1:{listening}", "--signing-key", str(other))
    with pytest.raises(LinkLostError, match="signed with another key"):
        linked(f"udpin:127.0.0.1:{listening}", signing_key=key_file)
