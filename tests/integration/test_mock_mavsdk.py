"""MAVSDK 4, unchanged, flies the mock vehicle over UDP: connect, arm, take off, offboard, land."""

import socket
import subprocess
import sys
import time

import pytest

mavsdk = pytest.importorskip("mavsdk", reason="mavsdk is not installed")

SPEED = 4.0
"""Simulated seconds per second: PX4 SITL is run like this too."""


@pytest.fixture
def mock_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "sim.mock", "--connect", f"udpout:127.0.0.1:{port}"]
    process = subprocess.Popen(
        [*command, "--speed", str(SPEED), "--exit-with-parent"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield port
    process.terminate()
    out, err = process.communicate(timeout=10)
    assert process.returncode == 0, err
    assert out.startswith("mock: px4")


@pytest.fixture
def drone(mock_port):
    configuration = mavsdk.Configuration.create_with_component_type(
        mavsdk.ComponentType.COMPANION_COMPUTER
    )
    instance = mavsdk.Mavsdk(configuration)
    instance.add_any_connection(f"udpin://127.0.0.1:{mock_port}")
    system = instance.first_autopilot(10.0)
    assert system is not None
    yield system
    instance.destroy()


def wait_for(condition, timeout_s=30.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if condition():
            return
        time.sleep(0.05)
    pytest.fail("waited in vain")


def test_mavsdk_flies_the_mock(drone):
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityNedYaw
    from mavsdk.plugins.param import Param
    from mavsdk.plugins.telemetry import Telemetry

    action, offboard, telemetry = Action(drone), Offboard(drone), Telemetry(drone)

    wait_for(telemetry.health_all_ok)
    assert telemetry.health().is_global_position_ok
    assert telemetry.position().latitude_deg == pytest.approx(47.397742, abs=1e-5)
    assert Param(drone).get_param_float("COM_OF_LOSS_T") == pytest.approx(1.0)
    assert Param(drone).get_param_int("NAV_RCL_ACT") == 2

    with pytest.raises(OffboardError):
        offboard.start()  # no setpoint was set

    action.arm()
    wait_for(telemetry.armed)
    action.set_takeoff_altitude(10.0)
    action.takeoff()
    wait_for(lambda: telemetry.position().relative_altitude_m > 9.0)
    assert telemetry.in_air()

    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    offboard.start()
    wait_for(lambda: telemetry.flight_mode().name == "OFFBOARD")
    offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, 0.0, 0.0))
    wait_for(lambda: telemetry.position_velocity_ned().position.north_m > 15.0)
    # As recorded: an integral still works against the drag.
    assert telemetry.position_velocity_ned().velocity.north_m_s == pytest.approx(2.65, abs=0.2)
    offboard.stop()
    wait_for(lambda: telemetry.flight_mode().name == "HOLD")

    action.land()
    wait_for(lambda: not telemetry.in_air())
    wait_for(lambda: not telemetry.armed())
    telemetry.destroy()
    offboard.destroy()
    action.destroy()
