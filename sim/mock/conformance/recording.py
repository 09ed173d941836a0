"""A recording of a real autopilot, on the autopilot's own clock.

The wall clock of a log is no measure of what an autopilot does: a simulator runs at 97 % of real
time, or at ten times of it. Every message with ``time_boot_ms`` ties one to the other.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from companion.world.frames import GeoPoint
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.packet import message_id, sender_of
from sim.mock.personality import Personality
from sim.mock.px4.personality import PX4
from sim.mock.tlog import read_frames

PREARM_CHECK = 0x10000000
ARMED = 0x80
POSITION_FLAG, CONSTANT_POSITION_FLAG = 0x10, 0x80
"""EKF_STATUS_REPORT: the horizontal position is good; it is only assumed."""
DEFAULT_BOOT_S = {"px4": 4.2, "ardupilot": 41.6}
"""From power-up to ready on the simulators' own clocks."""
USING_GPS = "EKF3 IMU0 is using GPS"
LATEST_BOOT_MS = 10 * 24 * 3600 * 1000
_PERSONALITIES = {
    mavlink.MAV_AUTOPILOT_PX4: PX4,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT,
}


@dataclass(frozen=True)
class Recording:
    """Both directions of one link; all times are seconds since the autopilot's power-up."""

    name: str
    personality: Personality
    system_id: int
    requests: list[tuple[float, bytes]]
    """What others sent, as bytes."""
    end_s: float
    messages: dict[str, list[tuple[float, Any]]] = field(repr=False)
    """What the autopilot sent, by name."""
    counts: Counter[int]
    """How often, by message id: of those without a name too."""

    def of(self, name: str) -> list[tuple[float, Any]]:
        """Return the messages of one type, oldest first."""
        return self.messages.get(name, [])

    @property
    def start_s(self) -> float:
        """When the first message of the autopilot came."""
        return min(messages[0][0] for messages in self.messages.values())

    @cached_property
    def boot_s(self) -> float:
        """How long it took from power-up to ready to fly, as far as the recording shows."""
        if self.personality is PX4:
            found = _first_change(
                (t, bool(m.onboard_control_sensors_health & PREARM_CHECK))
                for t, m in self.of("SYS_STATUS")
            )
        else:
            found = _first_change(
                (t, bool(m.flags & POSITION_FLAG and not m.flags & CONSTANT_POSITION_FLAG))
                for t, m in self.of("EKF_STATUS_REPORT")
            )
            told = (t for t, m in self.of("STATUSTEXT") if m.text == USING_GPS)
            found = found or next(told, None)
        default_s = DEFAULT_BOOT_S[self.personality.name]
        # Ready only when somebody did something: then it says nothing about the boot.
        return default_s if found is None or found > 2.0 * default_s else found

    @property
    def home(self) -> GeoPoint:
        """Where it was switched on: its origin, else its home, else its simulator's."""
        for name in ("GPS_GLOBAL_ORIGIN", "HOME_POSITION"):
            for _, m in self.of(name):
                return GeoPoint(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)
        return self.personality.home

    @property
    def heading_rad(self) -> float:
        """Where its nose pointed before it flew."""
        yaws = [m.yaw for _, m in self.of("ATTITUDE")]
        return float(yaws[min(len(yaws) - 1, 20)]) if yaws else 0.0

    @property
    def is_ground_port(self) -> bool:
        """Whether the link has PX4's ground-station rates: no HIGHRES_IMU there."""
        return self.personality is PX4 and not self.of("HIGHRES_IMU")


def read_recording(path: Path) -> Recording:
    """Read a telemetry log of PX4 or ArduPilot.

    Raises:
        UsageError: If it is no such log, or begins in flight.
    """
    try:
        frames = list(read_frames(path))
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot read {path}: {error}") from error
    return interpret(path.name.partition(".")[0], frames)


def interpret(name: str, frames: list[tuple[float, bytes]]) -> Recording:
    """Return a recording from frames and the wall-clock times in seconds they were logged at.

    Raises:
        UsageError: If no autopilot speaks in it, or it begins in flight.
    """
    system_id, personality = _find_autopilot(name, frames)
    parser = mavlink.MAVLink(None)
    ties: list[tuple[float, float]] = []
    theirs, requests, counts = [], [], Counter[int]()
    for wall_s, frame in frames:
        if sender_of(frame) != (system_id, 1):
            requests.append((wall_s, frame))
            continue
        counts[message_id(frame)] += 1
        try:
            message = parser.decode(bytearray(frame))
        except mavlink.MAVError:
            continue
        if message.get_type().startswith("UNKNOWN"):
            continue
        boot_s = _boot_time_s(message)
        if boot_s is not None:
            if ties and boot_s < ties[-1][1] - 1.0:
                break  # it was switched on anew: only the first life is compared
            ties.append((wall_s, max(boot_s, ties[-1][1] if ties else 0.0)))
        theirs.append((wall_s, message))
    clock = _Clock(ties)
    messages: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    for wall_s, message in theirs:
        messages[message.get_type()].append((clock.boot_s(wall_s), message))
    last_s = theirs[-1][0]
    recording = Recording(
        name=name,
        personality=personality,
        system_id=system_id,
        requests=[(clock.boot_s(t), frame) for t, frame in requests if t <= last_s],
        end_s=clock.boot_s(last_s),
        messages=dict(messages),
        counts=counts,
    )
    if recording.of("HEARTBEAT")[0][1].base_mode & ARMED:
        raise UsageError(f"{name} begins with an armed vehicle: how it came there is not in it")
    return recording


def _first_change(reports: Iterable[tuple[float, bool]]) -> float | None:
    """Return when something first became true that was not so before, ``None`` if it never did."""
    seen_false = False
    for t, value in reports:
        if value:
            return t if seen_false else None
        seen_false = True
    return None


class _Clock:
    """The autopilot's clock by the wall clock; beyond the ties both run alike."""

    def __init__(self, ties: list[tuple[float, float]]) -> None:
        self._wall = np.array([tie[0] for tie in ties] or [0.0])
        self._boot = np.array([tie[1] for tie in ties] or [0.0])

    def boot_s(self, wall_s: float) -> float:
        before, after = self._wall[0] - wall_s, wall_s - self._wall[-1]
        beyond = -max(0.0, before) + max(0.0, after)
        return float(np.interp(wall_s, self._wall, self._boot) + beyond)


def _find_autopilot(name: str, frames: list[tuple[float, bytes]]) -> tuple[int, Personality]:
    parser = mavlink.MAVLink(None)
    for _, frame in frames:
        system_id, component_id = sender_of(frame)
        if message_id(frame) == mavlink.MAVLINK_MSG_ID_HEARTBEAT and component_id == 1:
            heartbeat = parser.decode(bytearray(frame))
            personality = _PERSONALITIES.get(heartbeat.autopilot)
            if personality is not None:
                return system_id, personality
    raise UsageError(f"{name}: no PX4 or ArduPilot sends HEARTBEAT in it")


def _boot_time_s(message: Any) -> float | None:
    if message.get_type() == "TIMESYNC":
        asks = message.tc1 == 0 and message.ts1 < LATEST_BOOT_MS * 1e6
        return message.ts1 / 1e9 if asks else None
    boot_ms = getattr(message, "time_boot_ms", None)
    return boot_ms / 1e3 if boot_ms is not None and 0 < boot_ms < LATEST_BOOT_MS else None
