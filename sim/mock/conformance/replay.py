"""The mock, sent what was sent to a recorded autopilot, at the same moments of its clock."""

import struct
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench
from sim.mock.conformance.recording import Recording
from sim.mock.conformance.surroundings import events_of, has_transmitter
from sim.mock.packet import message_id, sender_of
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from sim.mock.vehicle import Settings

SAMPLED: dict[str, Callable[[Any], Any]] = {
    "HEARTBEAT": lambda message: (message.base_mode, message.custom_mode, message.system_status),
    "EXTENDED_SYS_STATE": lambda message: message.landed_state,
    "ESTIMATOR_STATUS": lambda message: message.flags,
    "EKF_STATUS_REPORT": lambda message: message.flags,
}
"""What is looked at all the time: when it changes, not when it is sent."""
AFTER_S = 0.5
"""The mock flies on for so long: what is a little late is seen."""


@dataclass(frozen=True)
class Flown:
    """What the mock made of it; times as in the recording."""

    messages: dict[str, list[tuple[float, Any]]] = field(repr=False)
    """What it sent on the recorded link, by name."""
    sampled: dict[str, list[tuple[float, Any]]] = field(repr=False)
    """What some messages would have said at any moment: (time, value) of every change."""
    parameters_differ: list[str]
    """Parameters that the recorded vehicle had set otherwise than the mock's own default."""

    def of(self, name: str) -> list[tuple[float, Any]]:
        """Return the messages of one type, oldest first."""
        return self.messages.get(name, [])


def replay(recording: Recording) -> Flown:
    """Fly the mock through a recording."""
    personality = recording.personality
    settings = Settings(
        place_vehicle(None, recording.home, personality),
        boot_s=recording.boot_s,
        radio=has_transmitter(recording),
        personality=personality,
        system_id=recording.system_id,
    )
    ground = recording.is_ground_port
    bench = Bench(settings, ground_links=(ground, not ground))
    autopilot = bench.vehicle.autopilot
    autopilot.body.yaw_rad = recording.heading_rad
    differ = _adopt_parameters(recording, autopilot.parameters)
    elsewhere = _senders_elsewhere(recording)
    watch = _Watch(bench, autopilot)

    happenings: list[tuple[float, int, Any]] = [
        (t, 0, frame) for t, frame in recording.requests
    ] + [(event.time_s, 1, event) for event in events_of(recording)]
    for t, kind, what in sorted(happenings, key=lambda item: item[:2]):
        watch.run_until(t)
        if kind == 1:
            what.happen(autopilot)
        else:
            bench.vehicle.receive(int(sender_of(what) in elsewhere), what)
    watch.run_until(recording.end_s + AFTER_S)

    messages: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    for received in bench.received:
        if received.link == 0 and received.packet[5:7] == bytes((recording.system_id, 1)):
            messages[received.name].append((received.time_s, received.message))
    return Flown(dict(messages), watch.changes, differ)


class _Watch:
    """Lets time pass and notes what changes."""

    def __init__(self, bench: Bench, autopilot: Any) -> None:
        self.changes: dict[str, list[tuple[float, Any]]] = {name: [] for name in SAMPLED}
        self._bench, self._autopilot = bench, autopilot
        builders = bench.vehicle.channels[0].builders
        numbers = {name: getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in SAMPLED}
        self._builders = {
            name: builders[number] for name, number in numbers.items() if number in builders
        }

    def run_until(self, time_s: float) -> None:
        if time_s > self._bench.time_s:
            self._bench.run(time_s - self._bench.time_s, until=self._look)
        self._look()

    def _look(self) -> bool:
        for name, build in self._builders.items():
            message = build(self._autopilot)
            if message is None:
                continue
            value = SAMPLED[name](message)
            changes = self.changes[name]
            if not changes or changes[-1][1] != value:
                changes.append((self._bench.time_s, value))
        return False


def _adopt_parameters(recording: Recording, parameters: Any) -> list[str]:
    """Set the mock's parameters to what the recording shows; return those that were otherwise."""
    parser = mavlink.MAVLink(None)
    written = {
        parser.decode(bytearray(frame)).param_id
        for _, frame in recording.requests
        if message_id(frame) == mavlink.MAVLINK_MSG_ID_PARAM_SET
    }
    differ = []
    for _, message in recording.of("PARAM_VALUE"):
        name = message.param_id
        if name in written or parameters.wire_type(name) is None or name.startswith("_"):
            continue
        theirs, ours = _wire_value(message), parameters.wire_bytes(name)
        if theirs != ours:
            differ.append(name)
            parameters.store(name, parameters.wire_type(name), theirs)
    return sorted(set(differ))


def _wire_value(message: Any) -> bytes:
    """Return the four bytes of PARAM_VALUE.param_value, which no float may touch."""
    packet = bytes(message.get_msgbuf())
    return packet[10 : 10 + min(4, packet[1])].ljust(4, b"\0") if packet else struct.pack("<f", 0.0)


def _senders_elsewhere(recording: Recording) -> set[tuple[int, int]]:
    """Return who spoke on another link of PX4: ground stations, where no text was recorded.

    PX4 sends texts on the links on which it hears a ground station, so a link with none of them
    is not the ground station's.
    """
    if recording.personality is not PX4 or recording.of("STATUSTEXT"):
        return set()
    parser = mavlink.MAVLink(None)
    heartbeats = (
        (frame, parser.decode(bytearray(frame)))
        for _, frame in recording.requests
        if message_id(frame) == mavlink.MAVLINK_MSG_ID_HEARTBEAT
    )
    return {sender_of(frame) for frame, m in heartbeats if m.type == mavlink.MAV_TYPE_GCS}
