"""The link against the mock vehicle: another process, another codec, real sockets."""

import contextlib
import socket
import subprocess
import sys

import numpy as np
import pytest

from companion import clock
from companion.errors import AmbiguousVehicleError, LinkOpenError
from companion.link.opening import connect
from companion.vehicle import EventKind, FlightMode, RequestKind, RequestState, SystemStatus

SPEED = 4
"""Simulated seconds per second."""
HOLD_STILL = np.zeros(3)


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Pilot:
    """Flies a vehicle by the link alone, 20 steps a second."""

    def __init__(self, vehicle):
        self.vehicle = vehicle
        self.events = []

    @property
    def state(self):
        return self.vehicle.state()

    def fly(self, until, *, velocity=None, timeout_s=20.0):
        """Step until ``until()``, streaming ``velocity`` if there is one."""
        step_s = self.vehicle.now_s()
        end_s = step_s + timeout_s
        next_heartbeat_s = step_s
        while not until():
            assert step_s < end_s, f"{self.vehicle.request_status()} {self.state}"
            step_s += 0.05
            self.vehicle.wait_until(step_s)
            self.events += self.vehicle.take_events()
            if velocity is not None:
                self.vehicle.send_velocity(velocity)
            if step_s >= next_heartbeat_s:
                self.vehicle.send_heartbeat(SystemStatus.ACTIVE)
                next_heartbeat_s += 1.0

    def ask(self, kind, *, velocity=None, **options):
        self.vehicle.request(kind, **options)
        self.fly(
            lambda: self.vehicle.request_status().state is not RequestState.PENDING,
            velocity=velocity,
        )
        return self.vehicle.request_status().state

    def ready(self):
        return self.state is not None and self.state.ready_to_arm and self.state.origin is not None

    def heard(self, kind):
        return any(event.kind is kind for event in self.events)


@pytest.fixture
def mock():
    """Start mock vehicles; stop them after the test."""
    processes = []

    def start(*options):
        command = [sys.executable, "-m", "sim.mock", "--autopilot", "px4", "--exit-with-parent"]
        processes.append(
            subprocess.Popen([*command, "--speed", str(SPEED), *options], stdout=subprocess.DEVNULL)
        )

    yield start
    for process in processes:
        process.terminate()
    for process in processes:
        process.wait(5.0)


@pytest.fixture
def linked():
    vehicles = []

    def link(url, **options):
        for _ in range(100):  # a TCP server may still be starting
            with contextlib.suppress(LinkOpenError):
                vehicles.append(connect(url, timeout_s=15.0, **options))
                return Pilot(vehicles[-1])
            clock.sleep_s(0.1)
        return pytest.fail(f"nobody listens on {url}")

    yield link
    for vehicle in vehicles:
        vehicle.close()


@pytest.fixture
def px4(mock, linked):
    """A PX4 that calls us over UDP, ready to arm."""

    def start(*options, **link_options):
        port = free_port()
        mock("--connect", f"udpout:127.0.0.1:{port}", *options)
        pilot = linked(f"udpin:127.0.0.1:{port}", **link_options)
        pilot.fly(pilot.ready)
        return pilot

    return start


def in_offboard(pilot):
    """Bring it up by its own take-off, then into OFFBOARD with the stream running."""
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    assert pilot.ask(RequestKind.TAKEOFF, altitude_m=8.0) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.state.mode is FlightMode.HOLD and pilot.state.position_ned_m[2] < -7)
    pilot.fly(lambda: pilot.vehicle.stats().setpoints_sent > 10, velocity=HOLD_STILL)
    assert pilot.ask(RequestKind.EXTERNAL, velocity=HOLD_STILL) is RequestState.CONFIRMED
    return pilot


def test_a_whole_flight(px4):
    pilot = px4()
    vehicle = pilot.vehicle
    assert vehicle.info.autopilot == "px4"
    assert vehicle.info.version.startswith("1.18")
    assert pilot.state.position_valid
    assert vehicle.read_param("COM_OF_LOSS_T") == 1.0
    assert isinstance(vehicle.read_param("COM_RC_IN_MODE"), int)
    in_offboard(pilot)
    assert pilot.state.mode_name == "OFFBOARD"
    pilot.fly(lambda: pilot.state.position_ned_m[0] > 4.0, velocity=np.array((2.0, 0.0, 0.0)))
    assert pilot.state.velocity_ned_mps[0] == pytest.approx(2.0, rel=0.25)
    assert pilot.state.position_ned_m[1] == pytest.approx(0.0, abs=0.5)
    assert pilot.ask(RequestKind.HOLD, velocity=HOLD_STILL) is RequestState.CONFIRMED
    assert pilot.ask(RequestKind.LAND) is RequestState.CONFIRMED
    pilot.fly(lambda: not pilot.state.armed, timeout_s=30.0)
    stats = vehicle.stats()
    assert (stats.packets_lost, stats.bytes_bad, stats.packets_foreign) == (0, 0, 0)
    assert {event.kind for event in pilot.events} <= {EventKind.STATUS_TEXT}


def test_refused_without_a_stream(px4):
    pilot = px4()
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    assert pilot.ask(RequestKind.EXTERNAL) is RequestState.REJECTED
    assert "TEMPORARILY_REJECTED" in pilot.vehicle.request_status().detail


@pytest.mark.parametrize("scheme", ["udpout", "tcp"])
def test_calling_a_vehicle_that_waits(mock, linked, scheme):
    port = free_port(socket.SOCK_STREAM if scheme == "tcp" else socket.SOCK_DGRAM)
    listening = "tcpin" if scheme == "tcp" else "udpin"
    mock("--connect", f"{listening}:127.0.0.1:{port}")
    pilot = linked(f"{scheme}:127.0.0.1:{port}")
    pilot.fly(pilot.ready)
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED


def test_setpoint_loss_shows_and_nothing_is_sent_by_itself(px4):
    pilot = in_offboard(px4())
    sent = pilot.vehicle.stats().setpoints_sent
    pilot.fly(lambda: pilot.state.mode is not FlightMode.EXTERNAL)
    assert pilot.state.system_status is SystemStatus.CRITICAL
    assert pilot.vehicle.stats().setpoints_sent == sent


def test_a_pilot_who_takes_over_shows(px4):
    pilot = in_offboard(px4("--radio", "--fault", "from=offboard,t=2,kind=rc_takeover"))
    pilot.fly(lambda: pilot.state.mode is not FlightMode.EXTERNAL, velocity=HOLD_STILL)
    assert pilot.state.mode_name == "POSCTL"


@pytest.mark.parametrize("fault", ["ekf_reset", "origin_move"])
def test_frame_events_raise_the_epoch(px4, fault):
    pilot = px4("--fault", f"from=arm,t=4,kind={fault}")
    before = pilot.state.frame_epoch
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.state.frame_epoch > before)


def test_a_reboot_is_told_and_recovered_from(px4):
    pilot = px4("--fault", "from=arm,t=4,kind=reboot")
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.heard(EventKind.REBOOT))
    pilot.fly(pilot.ready)
    assert not pilot.state.armed


def test_a_second_companion_is_told(px4):
    pilot = px4("--fault", "t=1,kind=second_companion")
    pilot.fly(lambda: pilot.heard(EventKind.FOREIGN_SETPOINT))
    assert "1/192" in next(e.text for e in pilot.events if e.kind is EventKind.FOREIGN_SETPOINT)


@pytest.mark.parametrize("message", ["gpi", "follow"])
def test_a_target_is_followed_by_its_reports(px4, message):
    pilot = px4(
        "--target", f"kind=straight,sysid=42,speed=2,at=30:0:10,to=30:80:10,message={message}",
        target_sysids=(42,),
    )  # fmt: skip
    pilot.fly(lambda: 42 in pilot.vehicle.targets())
    first = pilot.vehicle.targets()[42]
    pilot.fly(
        lambda: (
            pilot.vehicle.targets()[42].position.latitude_deg > first.position.latitude_deg + 2e-5
        )
    )
    later = pilot.vehicle.targets()[42]
    assert later.position.longitude_deg == pytest.approx(first.position.longitude_deg, abs=1e-6)
    assert later.time_s > first.time_s
    assert later.velocity_ned_mps[0] == pytest.approx(2.0, abs=0.2)


def test_two_vehicles_need_a_choice(mock, linked):
    port = free_port()
    mock(
        "--connect", f"udpout:127.0.0.1:{port}",
        "--target", "kind=circle,sysid=42,autopilot=px4",
    )  # fmt: skip
    with pytest.raises(AmbiguousVehicleError, match="1, 42"):
        linked(f"udpin:127.0.0.1:{port}")
    pilot = linked(f"udpin:127.0.0.1:{port}", vehicle_sysid=1, target_sysids=(42,))
    pilot.fly(lambda: pilot.ready() and 42 in pilot.vehicle.targets())
    assert pilot.vehicle.info.system_id == 1


def test_a_bad_link_is_counted_and_survived(px4):
    pilot = px4(
        "--fault", "kind=loss,percent=10",
        "--fault", "kind=corrupt,percent=5",
        "--fault", "kind=duplicate,percent=5",
    )  # fmt: skip
    in_offboard(pilot)
    stats = pilot.vehicle.stats()
    assert 8.0 < stats.loss_percent < 25.0
    assert stats.bytes_bad > 0
