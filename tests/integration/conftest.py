"""Mock vehicles in processes of their own, links to them, and a wire that is watched."""

import contextlib
import select
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from companion import clock
from companion.errors import CompanionError, LinkOpenError
from companion.link.opening import connect
from companion.session.viewer import headless_viewer
from companion.vehicle import FlightMode, LandedState, RequestKind, RequestState, SystemStatus
from tests.integration.running import Run

MOCK_SPEED = 4
"""Simulated seconds per second."""
RELAY_BUFFER_BYTES = 4 << 20
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

    def get_external(self, *, altitude_m=8.0, timeout_s=40.0):
        """Bring it up by its own take-off and into external mode, the stream running."""
        stream_first = self.vehicle.info.needs_stream_before_external
        if not stream_first:
            assert self.ask(RequestKind.EXTERNAL) is RequestState.CONFIRMED
        assert self.ask(RequestKind.ARM) is RequestState.CONFIRMED
        start_m = self.state.position_ned_m[2]
        assert self.ask(RequestKind.TAKEOFF, altitude_m=altitude_m) is RequestState.CONFIRMED
        self.fly(
            lambda: (
                self.state.mode is not FlightMode.TAKEOFF
                and self.state.landed is LandedState.IN_AIR
                and self.state.position_ned_m[2] - start_m < 1.0 - altitude_m
            ),
            timeout_s=timeout_s,
        )
        sent = self.vehicle.stats().setpoints_sent
        self.fly(lambda: self.vehicle.stats().setpoints_sent > sent + 10, velocity=HOLD_STILL)
        if stream_first:
            asked = self.ask(RequestKind.EXTERNAL, velocity=HOLD_STILL)
            assert asked is RequestState.CONFIRMED
        assert self.state.mode is FlightMode.EXTERNAL


class Relay(threading.Thread):
    """A wire between a vehicle that calls and a companion that listens; sees every datagram.

    ``to_vehicle`` and ``to_companion`` may be set to functions that change a datagram, or
    swallow it by returning ``None``.
    """

    def __init__(self, companion_port):
        super().__init__(daemon=True)
        self._companion = ("127.0.0.1", companion_port)
        self._vehicle = None
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.bind(("127.0.0.1", 0))
        for end in (self._front, self._back):
            # A mock at this speed fills the default buffer within 0.2 s: a busy machine loses some.
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RELAY_BUFFER_BYTES)
        self._stopping = threading.Event()
        self.port = self._front.getsockname()[1]
        self.of_companion = []
        self.to_vehicle = self.to_companion = lambda data: data

    def run(self):
        while not self._stopping.is_set():
            for ready in select.select([self._front, self._back], [], [], 0.1)[0]:
                with contextlib.suppress(ConnectionError):
                    data, sender = ready.recvfrom(65536)
                    if ready is self._front:
                        self._vehicle = sender
                        self.send(self.to_companion(data))
                    else:
                        self.of_companion.append(data)
                        changed = self.to_vehicle(data)
                        if changed is not None and self._vehicle is not None:
                            self._front.sendto(changed, self._vehicle)

    def send(self, data):
        """Send to the companion, as if the vehicle's port had."""
        if data is not None:
            self._back.sendto(data, self._companion)

    def stop(self):
        self._stopping.set()
        self.join()
        self._front.close()
        self._back.close()


@pytest.fixture
def port():
    return free_port


@pytest.fixture
def mock():
    """Start mock vehicles; stop them after the test."""
    processes = []

    def start(*options, autopilot="px4"):
        command = [sys.executable, "-m", "sim.mock", "--autopilot", autopilot]
        command += ["--exit-with-parent", "--speed", str(MOCK_SPEED), *options]
        processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))

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
def relay():
    relays = []

    def start(companion_port):
        relays.append(Relay(companion_port))
        relays[-1].start()
        return relays[-1]

    yield start
    for each in relays:
        each.stop()


@pytest.fixture(scope="session")
def vulkan():
    """Skip where the viewer cannot draw."""
    try:
        with headless_viewer((640, 480)) as address:
            ViewerClient.connect(address).get_state()
    except CompanionError as error:
        pytest.skip(str(error))


@pytest.fixture
def run(tmp_path):
    runs = []

    def start(*options, **how):
        runs.append(Run(*options, record=tmp_path / "sessions", **how))
        return runs[-1]

    yield start
    for started in runs:
        if started.process.poll() is None:
            started.process.kill()
            started.process.wait()
        started._reader.join(5.0)
        started.process.stdout.close()
        started.process.stderr.close()
