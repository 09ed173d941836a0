"""How it flies: the way, how long failsafes take, and how far it goes until it stops."""

import bisect
import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.conformance.recording import Recording
from sim.mock.conformance.replay import Flown
from sim.mock.conformance.table import Row
from sim.mock.packet import message_id

SHARE_LIMIT = 0.20
WAY_LIMIT_M = 2.0
SILENT_S = 0.6
"""No setpoint for so long: the stream has ended."""
MOVING_MPS = 1.0
SLOWED = 0.9
"""A failsafe is felt when the speed has fallen to this share of what it was."""
STOPPED = 0.15
LOOK_S = 20.0
_SETPOINTS = (84, 86)
_COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)
_MODES = frozenset({17, 20, 21, 176, 192})


@dataclass(frozen=True, slots=True)
class Stop:
    """A moment from which a moving vehicle should slow down."""

    time_s: float
    until_s: float
    """What comes next."""
    why: str


def rows(recording: Recording, flown: Flown) -> list[Row]:
    """Return the comparison of all motion."""
    theirs, ours = (
        _Track(recording.of("LOCAL_POSITION_NED")),
        _Track(flown.of("LOCAL_POSITION_NED")),
    )
    if not theirs.times or not ours.times:
        return []
    found = [_way(theirs, ours)]
    for stop in stops_of(recording):
        if theirs.speed(stop.time_s) > MOVING_MPS:
            found += _stopping(stop, theirs, ours)
    found += _failsafes(recording, flown)
    return [row for row in found if row is not None]


def stops_of(recording: Recording) -> list[Stop]:
    """Return the ends of setpoint streams and the changes of mode by command."""
    parser = mavlink.MAVLink(None)
    setpoints, commands = [], []
    for t, frame in recording.requests:
        number = message_id(frame)
        if number in _SETPOINTS:
            setpoints.append(t)
        elif number in _COMMANDS and parser.decode(bytearray(frame)).command in _MODES:
            commands.append(t)
    marks = sorted([*setpoints, *commands, recording.end_s])
    stops = []
    for t in setpoints:
        following = marks[bisect.bisect_right(marks, t) :]
        if following and following[0] - t > SILENT_S:
            stops.append(Stop(t, following[0], f"stream ends at {t:.1f} s"))
    return stops


class _Track:
    """Position and velocity by time."""

    def __init__(self, messages: list[tuple[float, Any]]) -> None:
        self.times = [t for t, _ in messages]
        self._messages = [message for _, message in messages]

    def at(self, time_s: float) -> Any:
        index = bisect.bisect_left(self.times, time_s)
        index = min(index, len(self.times) - 1)
        if index > 0 and time_s - self.times[index - 1] < self.times[index] - time_s:
            index -= 1
        return self._messages[index]

    def speed(self, time_s: float) -> float:
        here = self.at(time_s)
        return math.hypot(here.vx, here.vy)

    def first_slower(self, start_s: float, end_s: float, speed_mps: float) -> float | None:
        for t in self.times[bisect.bisect_left(self.times, start_s) :]:
            if t > end_s:
                return None
            if self.speed(t) < speed_mps:
                return t
        return None

    def distance(self, start_s: float, end_s: float) -> float:
        a, b = self.at(start_s), self.at(end_s)
        return math.hypot(b.x - a.x, b.y - a.y)


def _way(theirs: _Track, ours: _Track) -> Row:
    """Compare how far apart the two ways are at their ends and at every moment."""
    worst_m, where = 0.0, ""
    length_m, last = 0.0, theirs.at(theirs.times[0])
    for t in theirs.times:
        there, here = theirs.at(t), ours.at(t)
        length_m += math.dist((there.x, there.y, there.z), (last.x, last.y, last.z))
        last = there
        off_m = math.dist((there.x, there.y, there.z), (here.x, here.y, here.z))
        if off_m > worst_m:
            worst_m, where = off_m, f"{t:.1f} s"
    limit_m = WAY_LIMIT_M + 0.1 * length_m
    return Row("the way flown", f"{length_m:.0f} m", "", worst_m, limit_m, "m", where)


def _stopping(stop: Stop, theirs: _Track, ours: _Track) -> list[Row]:
    """Compare when the end of a stream is felt, and how far it goes until it has stopped."""
    end_s = min(stop.until_s, stop.time_s + LOOK_S)
    delays, distances = [], []
    for track in (theirs, ours):
        speed_mps = track.speed(stop.time_s)
        felt_s = track.first_slower(stop.time_s, end_s, SLOWED * speed_mps)
        stopped_s = track.first_slower(stop.time_s, end_s, max(0.2, STOPPED * speed_mps))
        delays.append(None if felt_s is None else felt_s - stop.time_s)
        distances.append(None if stopped_s is None else track.distance(stop.time_s, stopped_s))
    found = [_share("failsafe felt after", delays, "s", stop.why)]
    if distances[0] is not None:
        found.append(_share("stopping distance", distances, "m", stop.why))
    return [row for row in found if row is not None]


def _failsafes(recording: Recording, flown: Flown) -> list[Row]:
    """Compare when a lost stream is said to be a failsafe (PX4 says so)."""
    found = []
    for stop in stops_of(recording):
        delays = []
        for side in (recording, flown):
            said = [
                t - stop.time_s
                for t, m in side.of("STATUSTEXT")
                if stop.time_s < t < stop.until_s and m.text.startswith("Failsafe activated")
            ]
            delays.append(said[0] if said else None)
        if delays[0] is not None:
            found.append(_share("failsafe told after", delays, "s", stop.why))
    return [row for row in found if row is not None]


def _share(what: str, values: list[float | None], unit: str, where: str) -> Row | None:
    theirs, ours = values
    if theirs is None and ours is None:
        return None
    words = ["never" if value is None else f"{value:.2f} {unit}" for value in values]
    if theirs is None or ours is None:
        deviation = math.inf
    else:
        deviation = 100.0 * abs(ours - theirs) / max(theirs, 1e-3)
    return Row(what, words[0], words[1], deviation, 100.0 * SHARE_LIMIT, "%", where)
