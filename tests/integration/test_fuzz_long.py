"""A million packets that lie, in front of the whole link: nothing raises, nobody else is believed.

The packets are mutations of a recorded flight of a real autopilot: bits flipped, lengths that lie,
pieces cut out and doubled, other senders with right checksums, random fields with right checksums,
and MAVLink 1. ``pytest -m slow`` runs it; the figures are printed.
"""

import resource
import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.opening import attach
from companion.vehicle import CommandAnswer, EventKind, Verdict

PACKETS = 1_000_000
BATCH = 500
WARM_UP = 100_000
"""Memory is measured from here on: caches and tables have their size."""
RECORDINGS = ("px4_short_flight_companion_30s", "ap_short_flight_companion")


def checked(frame):
    """Return a MAVLink 2 frame with a right checksum, whatever its header and payload say."""
    kind = dialect.mavlink_map.get(int.from_bytes(frame[7:10], "little"))
    if kind is None:
        return bytes(frame)
    end = 10 + frame[1]
    crc = dialect.x25crc(bytes(frame[1:end]) + bytes((kind.crc_extra,))).crc
    return bytes(frame[:end]) + struct.pack("<H", crc)


def as_version_1(frame):
    """Return the frame as MAVLink 1, where its message has such a form."""
    number = int.from_bytes(frame[7:10], "little")
    kind = dialect.mavlink_map.get(number)
    if kind is None or number > 255:
        return frame
    payload = frame[10 : 10 + frame[1]].ljust(kind.unpacker.size, b"\0")
    body = bytes((len(payload), frame[4], frame[5], frame[6], number)) + payload
    crc = dialect.x25crc(body + bytes((kind.crc_extra,))).crc
    return b"\xfe" + body + struct.pack("<H", crc)


class Mutator:
    """Makes packets of recorded ones, and says of each what kind of lie it is."""

    def __init__(self, frames, rng):
        self.frames, self.rng = frames, rng
        self.lies = (
            self.flip, self.length, self.cut, self.double, self.stranger, self.fields,
            self.version_1, self.noise, *[self.honest] * 6,
        )  # fmt: skip
        self.next = 0
        self.counts = dict.fromkeys((lie.__name__ for lie in self.lies), 0)

    def packet(self):
        lie = self.lies[self.rng.integers(len(self.lies))]
        self.counts[lie.__name__] += 1
        self.next = (self.next + 1) % len(self.frames)  # in order: time runs forwards
        return lie(bytearray(self.frames[self.next]))

    def flip(self, frame):
        for _ in range(self.rng.integers(1, 6)):
            frame[self.rng.integers(len(frame))] ^= 1 << self.rng.integers(8)
        return bytes(frame)

    def length(self, frame):
        frame[1] = self.rng.integers(256)
        if self.rng.random() < 0.5:
            return bytes(frame)
        frame[5] = 2
        return checked(frame.ljust(300, b"\0"))

    def cut(self, frame):
        return bytes(frame[: self.rng.integers(1, len(frame))])

    def double(self, frame):
        return bytes(frame) * 2

    def stranger(self, frame):
        frame[5], frame[6] = self.rng.integers(256), self.rng.integers(256)
        if frame[5] == 1 and frame[6] in (1, 191):
            frame[5] = 2
        return checked(frame)

    def fields(self, frame):
        """Random fields of a message of a stranger: a perfect packet that means nonsense."""
        frame[5], frame[6] = self.rng.choice([2, 7, 42, 200, 255]), self.rng.integers(256)
        frame[10:-2] = self.rng.bytes(len(frame) - 12)
        return checked(frame)

    def version_1(self, frame):
        frame[5] = 9
        return as_version_1(bytes(frame))

    def noise(self, frame):
        return self.rng.bytes(self.rng.integers(1, 300))

    def honest(self, frame):
        return bytes(frame)


def resident_mib():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_a_million_packets_that_lie(recorded_flight, memory_transport, name):
    rng = np.random.default_rng(5)
    frames = [frame for _, frame in recorded_flight(name) if (frame[5], frame[6]) == (1, 1)]
    transport = memory_transport()
    for frame in frames[:400]:
        transport.deliver(frame)
    vehicle = attach(transport, url="memory", now=transport.now, target_sysids=(42,))
    vehicle.judge_commands(lambda order: CommandAnswer(Verdict.DENIED))
    mutator = Mutator(frames, rng)
    honest_positions = {
        struct.unpack_from("<3f", frame[10 : 10 + frame[1]].ljust(28, b"\0"), 4)
        for frame in frames
        if frame[7:10] == dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED.to_bytes(3, "little")
    }
    start_mib, num_states = None, 0
    for batch in range(PACKETS // len(RECORDINGS) // BATCH):
        for number in range(BATCH):
            peer = "peer" if rng.random() < 0.8 else f"stranger {rng.integers(1000)}"
            transport.deliver(mutator.packet(), after_s=number * 1e-3, peer=peer)
        vehicle.wait_until(transport.now_s + 0.6)
        vehicle.send_heartbeat(4)
        vehicle.send_velocity(np.zeros(3))
        for event in vehicle.take_events():
            assert event.kind in EventKind
        state = vehicle.state()
        if state is not None:
            assert tuple(state.position_ned_m) in honest_positions, "believed a stranger"
            assert np.isfinite(state.velocity_ned_mps).all()
            num_states += 1
        assert set(vehicle.targets()) <= {42}
        transport.sent.clear()
        if batch * BATCH >= WARM_UP and start_mib is None:
            start_mib = resident_mib()
    grown_mib = resident_mib() - start_mib
    stats = vehicle.stats()
    print(
        f"{name}: {sum(mutator.counts.values())} packets {mutator.counts}; {stats.packets_received}"
        f" of the vehicle, {stats.packets_foreign} foreign, {stats.bytes_bad} bad bytes; resident"
        f" memory grew by {grown_mib:.1f} MiB to {resident_mib():.0f} MiB"
    )
    assert num_states > 100
    assert grown_mib < 20.0
