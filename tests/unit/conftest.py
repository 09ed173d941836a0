"""A link on a memory transport, what an autopilot says on it, a telemetry log, a random city."""

import lzma
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.opening import attach


class Bench:
    """One vehicle under test, one autopilot on the other end of a memory transport."""

    def __init__(self, transport, sender_class):
        self.transport = transport
        self.sender_class = sender_class
        self.autopilot = self.sender(1)
        self.vehicle = None
        self.tapped = []
        self.answers = {}
        transport.on_sent = self._answer

    def sender(self, system_id, component_id=1, **options):
        return self.sender_class(self.transport, system_id, component_id, **options)

    def attach(self, **options):
        """Attach to the PX4 (or what ``custom``, ``autopilot`` say) of system 1."""
        heartbeat = {key: options.pop(key) for key in ("autopilot",) if key in options}
        mode = 4 if heartbeat.get("autopilot") == 3 else 0x03040000
        self.autopilot.heartbeat(mode, **heartbeat)
        self.vehicle = attach(
            self.transport,
            url="memory",
            now=self.transport.now,
            tap=lambda *frame: self.tapped.append(frame),
            **options,
        )
        return self.vehicle

    def run(self, duration_s=0.01):
        self.vehicle.wait_until(self.transport.now_s + duration_s)

    def position(self, *, boot_ms=60_000, x=1.0, y=2.0, z=-3.0, vx=0.5):
        self.autopilot.send(
            dialect.MAVLink_local_position_ned_message(boot_ms, x, y, z, vx, 0.0, 0.0)
        )

    def attitude(self, *, boot_ms=60_000, yaw=0.3):
        self.autopilot.send(dialect.MAVLink_attitude_message(boot_ms, 0.1, 0.2, yaw, 0, 0, 0))

    def origin(self, latitude=473977420, longitude=85455940, altitude=489400):
        self.autopilot.send(
            dialect.MAVLink_gps_global_origin_message(latitude, longitude, altitude)
        )

    def estimator(self, flags=0x37F):
        self.autopilot.send(
            dialect.MAVLink_estimator_status_message(0, flags, 0, 0, 0, 0, 0, 0, 0, 0)
        )

    def landed(self, landed_state):
        self.autopilot.send(dialect.MAVLink_extended_sys_state_message(0, landed_state))

    def acknowledge(self, command, result, *, after_s=0.0, target=(1, 191)):
        self.autopilot.send(
            dialect.MAVLink_command_ack_message(command, result, 0, 0, *target), after_s=after_s
        )

    def flying(self):
        """Let all that a snapshot needs arrive."""
        self.position()
        self.attitude()
        self.origin()
        self.estimator()
        self.landed(2)
        self.run()

    def commands(self, number):
        sent = self.transport.sent_of("COMMAND_LONG")
        return [message for message in sent if message.command == number]

    def _answer(self, message):
        if message.get_type() == "COMMAND_LONG" and message.command in self.answers:
            self.answers[message.command](message)


OFFBOARD = 0x60000
ARMED = 128


class FlightLog:
    """Writes a telemetry log as a link would, of a PX4 under the setpoints of a companion."""

    start_us = 1_795_356_187_000_000
    good_flags = 0x37F

    def __init__(self, folder):
        self.path = folder / "flight.tlog"
        self.data = b""
        self.senders = {}

    def add(self, time_s, message, system=1, component=1):
        sender = self.senders.setdefault(
            (system, component), dialect.MAVLink(None, system, component)
        )
        frame = bytes(message.pack(sender))
        sender.seq = (sender.seq + 1) % 256
        self.data += (self.start_us + round(time_s * 1e6)).to_bytes(8, "big") + frame

    def lose(self, count):
        """Let sequence numbers of the vehicle go by; the last comes again with -1."""
        sender = self.senders[1, 1]
        sender.seq = (sender.seq + count) % 256

    def heartbeat(self, time_s, mode, *, armed=True, status=4):
        base = 1 | (ARMED if armed else 0)
        self.add(time_s, dialect.MAVLink_heartbeat_message(2, 12, base, mode, status, 3))

    def position(self, time_s, north, *, up=10.0, speed=2.0):
        at_ms = round(time_s * 1000)
        message = dialect.MAVLink_local_position_ned_message(at_ms, north, 0.0, -up, speed, 0, 0)
        self.add(time_s, message)

    def setpoint(self, time_s, component=191):
        message = dialect.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 3527, 0, 0, 0, 2.0, 0, 0, 0, 0, 0, 0, 0
        )
        self.add(time_s, message, 1, component)

    def fly(
        self,
        *,
        begin_s=0.0,
        end_s=20.0,
        mode=lambda _: OFFBOARD,
        status=lambda _: 4,
        sends=lambda _: True,
        speaks=lambda _: True,
        north=lambda t: 2.0 * t,
        fix=lambda _: 3,
        flags=lambda _: FlightLog.good_flags,
        extra=lambda _log, _t: None,
    ):
        """Fly north at 2 m/s under the setpoints of a companion at 10 Hz."""
        for index in range(round(begin_s * 10), round(end_s * 10)):
            t = index / 10
            if speaks(t):
                if index % 10 == 0:
                    self.heartbeat(t, mode(t), status=status(t))
                    self.add(t, dialect.MAVLink_extended_sys_state_message(0, 2))
                    self.add(t, dialect.MAVLink_estimator_status_message(0, flags(t), *[0] * 8))
                    self.add(t, dialect.MAVLink_gps_raw_int_message(0, fix(t), *[0] * 7, 10))
                self.position(t + 0.01, north(t))
            if sends(t):
                self.setpoint(t + 0.02)
            extra(self, t)

    def write(self):
        """Write the file and return its path."""
        self.path.write_bytes(self.data)
        return self.path


@pytest.fixture
def flight_log(tmp_path):
    return FlightLog(tmp_path)


@pytest.fixture
def bench(memory_transport, sender):
    return Bench(memory_transport(), sender)


@pytest.fixture(scope="session")
def random_city():
    """Make footprints and heights of a city of random polygons, most of them concave."""

    def ring_around(rng, center, corners, radius):
        angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, corners))
        reach = radius * rng.uniform(0.2, 1.0, corners)
        ring = center + np.stack((reach * np.cos(angle), reach * np.sin(angle)), axis=1)
        return ring[::-1] if rng.random() < 0.5 else ring

    def make(seed, count=6):
        rng = np.random.default_rng(seed)
        footprints = []
        while len(footprints) < count:
            ring = ring_around(rng, rng.uniform(10.0, 90.0, 2), int(rng.integers(3, 10)), 25.0)
            if shapely.Polygon(ring).is_valid and shapely.Polygon(ring).area > 1.0:
                footprints.append(ring)
        return footprints, rng.uniform(10.0, 90.0, count)

    return make


@pytest.fixture(scope="session")
def real_logs(tmp_path_factory):
    """The two recordings of real autopilots, unpacked into a folder."""
    folder = tmp_path_factory.mktemp("real")
    for packed in (Path(__file__).parents[1] / "data").glob("*.tlog.xz"):
        (folder / packed.stem).write_bytes(lzma.decompress(packed.read_bytes()))
    return folder


@pytest.fixture
def px4(bench):
    bench.attach()
    bench.flying()
    return bench


@pytest.fixture
def ardupilot(bench):
    bench.attach(autopilot=3)
    return bench
