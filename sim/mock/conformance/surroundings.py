"""What reached a recorded vehicle by other ways than the recorded link.

A transmitter is on no link, and a ground station may be on another one. A change of mode that
nobody on the link asked for, and that is no failsafe either, was a person's: the mock is told so.
"""

import bisect
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import FAILSAFE, Autopilot, FlightMode
from sim.mock.conformance.recording import ARMED, Recording
from sim.mock.packet import message_id
from sim.mock.px4.modes import Mode as Px4Mode
from sim.mock.px4.personality import PX4

ASKED_WITHIN_S = 1.3
"""A HEARTBEAT shows what was asked for at most so much later."""
DEFLECTED = 300
"""A stick that is moved so far may take over."""
RADIO_LOST, RADIO_BACK = "Radio Failsafe", "Radio Failsafe Cleared"
SETPOINT_IDS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
)
STREAM_GAP_S = 0.6
_ASKS = {11, 20, 21, 22, 176, 192, 400, 17}


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person, or the weather, did to the vehicle."""

    time_s: float
    mode: str | None = None
    """The mode that a person chose."""
    by_pilot: bool = True
    """Whether it was the switch of a transmitter, and not a ground station elsewhere."""
    radio_lost: bool | None = None
    """Whether the transmitter fell silent, or came back."""

    def happen(self, autopilot: Autopilot) -> None:
        """Let it happen to the mock."""
        if self.mode is not None:
            autopilot.choose_mode(self.mode, by_pilot=self.by_pilot)
        if self.radio_lost is not None:
            autopilot.lose_radio(lost=self.radio_lost)


def events_of(recording: Recording) -> list[Event]:
    """Return what happened besides the recorded requests, oldest first."""
    events = [
        Event(t, radio_lost=m.text == RADIO_LOST)
        for t, m in recording.of("STATUSTEXT")
        if m.text in (RADIO_LOST, RADIO_BACK)
    ]
    asked = _times_of_requests(recording)
    moved = _times_of_moving_sticks(recording)
    reports = recording.of("HEARTBEAT")
    for (earlier_s, before), (t, heartbeat) in pairwise(reports):
        changed = heartbeat.custom_mode != before.custom_mode
        flying = before.base_mode & heartbeat.base_mode & ARMED
        by_itself = FAILSAFE in (heartbeat.system_status, before.system_status)
        if not (changed and flying) or by_itself:
            continue
        begins_s = max(earlier_s, t - ASKED_WITHIN_S)
        if any(begins_s - 0.2 <= cause_s <= t + 0.05 for cause_s in (*asked, *moved)):
            continue
        mode = _mode_named(recording, heartbeat.custom_mode)
        if mode is not None and not _follows_by_itself(recording, before.custom_mode, mode):
            when_s = _moment_between(recording, earlier_s, t)
            by_pilot = has_transmitter(recording)
            events.append(Event(when_s, mode=mode.name.lower(), by_pilot=by_pilot))
    return sorted(events, key=lambda event: event.time_s)


def has_transmitter(recording: Recording) -> bool:
    """Return whether a pilot's transmitter was there all the time."""
    if recording.personality is not PX4:
        return True  # ArduPilot's simulator always has one
    return bool(recording.of("RC_CHANNELS")) and not any(
        _is(frame, mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL) for _, frame in recording.requests
    )


def _times_of_requests(recording: Recording) -> list[float]:
    times = []
    parser = mavlink.MAVLink(None)
    for t, frame in recording.requests:
        if _is(frame, mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT):
            if parser.decode(bytearray(frame)).command in _ASKS:
                times.append(t)
        elif _is(frame, mavlink.MAVLINK_MSG_ID_SET_MODE):
            times.append(t)
    return times


def _times_of_moving_sticks(recording: Recording) -> list[float]:
    parser = mavlink.MAVLink(None)
    return [
        t
        for t, frame in recording.requests
        if _is(frame, mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL)
        and _is_deflected(parser.decode(bytearray(frame)))
    ]


def _is_deflected(sticks: Any) -> bool:
    axes = sticks.x, sticks.y, sticks.r, sticks.z - 500
    return any(abs(axis) > DEFLECTED for axis in axes)


def _moment_between(recording: Recording, start_s: float, end_s: float) -> float:
    """Return when a mode changed that only HEARTBEATs at both times show.

    ArduPilot shows it at once. PX4's echo of its target, ten times a second, jumps with it.
    """
    if recording.personality is not PX4:
        return end_s
    echoes = [
        (t, (m.type_mask, round(m.vx, 1), round(m.vy, 1)))
        for t, m in recording.of("POSITION_TARGET_LOCAL_NED")
        if start_s <= t <= end_s
    ]
    return next((t for t, echo in echoes if echo != echoes[0][1]), end_s)


def _is(frame: bytes, *numbers: int) -> bool:
    return message_id(frame) in numbers


def _mode_named(recording: Recording, custom_mode: int) -> FlightMode | None:
    for mode in recording.personality.kind.modes.values():
        number = mode.custom_mode if isinstance(mode, Px4Mode) else getattr(mode, "value", None)
        if number == custom_mode:
            return mode
    return None


def _follows_by_itself(recording: Recording, before: int, mode: FlightMode) -> bool:
    """Return whether PX4 goes there without being asked: from take-off to hold."""
    if recording.personality is not PX4:
        return False
    return before == Px4Mode.TAKEOFF.custom_mode and mode is Px4Mode.LOITER


class Causes:
    """When something happened from which a change of state can follow."""

    def __init__(self, times_s: list[float]) -> None:
        """Take the moments, in any order."""
        self._times_s = sorted(times_s)

    @classmethod
    def of(cls, recording: Recording) -> "Causes":
        """Return the commands, the beginnings and ends of streams, and what others did."""
        streamed = [t for t, frame in recording.requests if _is(frame, *SETPOINT_IDS)]
        edges = [b for a, b in pairwise([-math.inf, *streamed]) if b - a > STREAM_GAP_S]
        edges += [a for a, b in pairwise([*streamed, math.inf]) if b - a > STREAM_GAP_S]
        others = [event.time_s for event in events_of(recording)]
        return cls([0.0, *_times_of_requests(recording), *edges, *others])

    def since(self, time_s: float) -> float:
        """Return how long ago the last of them was."""
        index = bisect.bisect_right(self._times_s, time_s) - 1
        return time_s - self._times_s[max(0, index)]
