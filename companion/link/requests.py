"""One request to the vehicle, from the first packet to what its heartbeat shows.

A request is confirmed by the vehicle's own state, never by an acknowledgement alone: PX4's
HEARTBEAT lags its COMMAND_ACK by up to a second, and acceptance is not yet the deed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.autopilots import Autopilot, Command
from companion.link.connection import Connection
from companion.link.messages import command_long
from companion.link.telemetry import Telemetry
from companion.vehicle import (
    EventKind,
    FlightMode,
    RequestKind,
    RequestState,
    RequestStatus,
    Severity,
    VehicleEvent,
)

TRIES = 3
RETRY_S = 0.7
"""Acknowledgements were measured at 1 to 30 ms; this leaves room for a slow radio."""
SILENCE_S = 0.8
"""Where nothing was heard for longer, a failsafe or a pilot may have chosen a mode (PX4 leaves
OFFBOARD after a second without setpoints): no mode is asked for again until a HEARTBEAT tells."""
_LOOK_AGAIN_S = 0.05
_ACK_WITHIN_S = 2.0
"""An answer later than this is not waited for any more; it was lost."""
IN_PROGRESS_S = 3.0
"""How much longer the vehicle may take after each IN_PROGRESS."""
_SHOW_WITHIN_S = 3.5
"""Heartbeats come once a second; two may be lost."""
_CLIMB_WITHIN_S = 10.0
"""ArduPilot spins up for 3 s before it leaves the ground."""
_TEXT_BELONGS_S = 1.0
"""A STATUSTEXT this soon after a rejection is its reason."""

_MODES = {
    RequestKind.EXTERNAL: FlightMode.EXTERNAL,
    RequestKind.HOLD: FlightMode.HOLD,
    RequestKind.LAND: FlightMode.LAND,
    RequestKind.RETURN: FlightMode.RETURN,
}

_RESULT_NAMES = {
    number: entry.name.removeprefix("MAV_RESULT_")
    for number, entry in dialect.enums["MAV_RESULT"].items()
}


@dataclass(frozen=True, slots=True)
class Plan:
    """What to send for a request, and how to see that it has happened."""

    command: Command
    is_seen: Callable[[], bool]
    show_within_s: float = _SHOW_WITHIN_S
    yields: bool = True
    """Whether it is given up when somebody else chooses a mode meanwhile: the pilot wins, and a
    late try of ours must not take the vehicle back."""


def plan_request(
    kind: RequestKind, autopilot: Autopilot, telemetry: Telemetry, altitude_m: float | None
) -> Plan | str:
    """Return the plan for ``kind``, or in words why there is none.

    Args:
        kind: What to ask for.
        autopilot: The firmware's ways.
        telemetry: Where the vehicle's state shows.
        altitude_m: For a take-off: height above the ground the vehicle stands on.

    Raises:
        ValueError: If a take-off comes without an altitude above zero.
    """
    if kind in (RequestKind.ARM, RequestKind.DISARM):
        arms = kind is RequestKind.ARM
        # param2 stays 0: never forced, so a vehicle in the air refuses to disarm
        params = (float(arms), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        command = Command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, params)
        return Plan(command, lambda: telemetry.armed is arms, yields=False)
    if kind is RequestKind.TAKEOFF:
        if altitude_m is None or not 0.0 < altitude_m < 1e4:
            raise ValueError(f"a take-off needs an altitude above zero, got {altitude_m}")
        take_off = autopilot.take_off(altitude_m, telemetry.altitude_amsl_m())
        if take_off is None:
            return "the altitude above sea level is not known: no GPS_GLOBAL_ORIGIN yet"
        return Plan(
            take_off,
            lambda: autopilot.takes_off(telemetry.mode, telemetry.landed),
            _CLIMB_WITHIN_S,
        )
    mode = _MODES[kind]
    return Plan(autopilot.set_mode(mode), lambda: telemetry.mode is mode)


class Request:
    """Sends a command up to three times, hears the answer, and watches for the deed."""

    def __init__(
        self,
        kind: RequestKind,
        plan: Plan,
        telemetry: Telemetry,
        now_s: float,
        replaced: "Request | None" = None,
    ) -> None:
        self._plan = plan
        self._telemetry = telemetry
        self._started_s = now_s
        self._mode_before = telemetry.mode_name
        self._seen_before = plan.is_seen()
        """Already so: then its being seen proves nothing, and an acknowledgement must come."""
        self._stray_acks = 0 if replaced is None else replaced.acks_to_come(plan.command, now_s)
        """Answers that may still come, meant for the request before this one."""
        self._unanswered = 0
        self._sent_s = now_s
        self._accepted = False
        self._tries = 0
        self._due_s: float | None = now_s
        self._ended_s = now_s
        self._last_text = ""
        self.status = RequestStatus(kind, RequestState.PENDING)

    @property
    def command(self) -> Command:
        """What is asked of the vehicle."""
        return self._plan.command

    @property
    def due_s(self) -> float | None:
        """When ``advance`` has something to do; ``None`` once the request has ended."""
        return self._due_s

    def advance(self, now_s: float, *, mode_known: bool) -> int | None:
        """Let time pass; return the ``confirmation`` count if the command is to be sent now."""
        if self._due_s is None or now_s < self._due_s:
            return None
        if self._accepted:
            waited_s = now_s - self._started_s
            self._end(RequestState.TIMED_OUT, f"accepted, but not seen in {waited_s:.1f} s", now_s)
            return None
        if self._tries == TRIES:
            self._end(RequestState.TIMED_OUT, f"no answer to {TRIES} tries", now_s)
            return None
        if self._plan.yields and not mode_known:
            self._due_s = now_s + _LOOK_AGAIN_S
            return None
        self._due_s = now_s + RETRY_S
        self._tries += 1
        self._unanswered += 1
        self._sent_s = now_s
        return self._tries - 1

    def hear_ack(self, command: int, result: int, now_s: float) -> None:
        """Take in a COMMAND_ACK addressed to us."""
        # Stamped with the last look at the link, if the loop was away: but no answer comes first.
        now_s = max(now_s, self._sent_s)
        if command != self._plan.command.number:
            return
        if self._stray_acks:
            self._stray_acks -= 1
            return
        self._unanswered = max(0, self._unanswered - 1)
        if self._due_s is None:
            return
        if result == dialect.MAV_RESULT_IN_PROGRESS:
            self._tries = TRIES  # it has arrived: never send it again
            self._due_s = now_s + IN_PROGRESS_S
        elif result == dialect.MAV_RESULT_ACCEPTED:
            if not self._accepted:
                self._accepted = True
                self._due_s = now_s + self._plan.show_within_s
        else:
            name = _RESULT_NAMES.get(result, f"MAV_RESULT {result}")
            detail = f"{name}: {self._last_text}" if self._last_text else name
            self._end(RequestState.REJECTED, detail, now_s)

    def hear_text(self, text: str, now_s: float) -> None:
        """Take in a STATUSTEXT of a warning or worse: it may be the reason of a rejection."""
        if self._due_s is not None:
            self._last_text = text
        elif (
            self.status.state is RequestState.REJECTED
            and now_s - self._ended_s <= _TEXT_BELONGS_S
            and text not in self.status.detail
        ):
            self.status = replace(self.status, detail=f"{self.status.detail}: {text}")

    def hear_state(self, now_s: float) -> None:
        """Look whether the vehicle's state shows the deed, or somebody else's."""
        heartbeat_time_s = self._telemetry.heartbeat_time_s
        if self._due_s is None or heartbeat_time_s is None or heartbeat_time_s < self._started_s:
            return
        if self._plan.is_seen():
            if self._accepted or not self._seen_before:
                self._end(RequestState.CONFIRMED, "", now_s)
        elif self._plan.yields and self._telemetry.mode_name != self._mode_before:
            detail = f"somebody else chose {self._telemetry.mode_name}"
            self._end(RequestState.REJECTED, detail, now_s)

    def acks_to_come(self, command: Command, now_s: float) -> int:
        """Return how many answers to this request could be taken for ones to ``command``."""
        same = command.number == self.command.number
        return self._unanswered if same and now_s - self._sent_s <= _ACK_WITHIN_S else 0

    def abandon(self, reason: str, now_s: float) -> None:
        """End a pending request that cannot come true any more."""
        if self._due_s is not None:
            self._end(RequestState.REJECTED, reason, now_s)

    def _end(self, state: RequestState, detail: str, now_s: float) -> None:
        self.status = replace(self.status, state=state, detail=detail)
        self._due_s = None
        self._ended_s = now_s


class Requests:
    """The one request under way, and the sending of its packets."""

    def __init__(
        self, connection: Connection, autopilot: Autopilot, system_id: int, telemetry: Telemetry
    ) -> None:
        self._connection = connection
        self._autopilot = autopilot
        self._system_id = system_id
        self._telemetry = telemetry
        self._request: Request | None = None
        self._without_request = RequestStatus()
        self._heard_s = -math.inf
        self._silent_s = -math.inf
        """When the last silence was noticed, or ended."""

    @property
    def status(self) -> RequestStatus:
        """How far the newest request has come."""
        return self._without_request if self._request is None else self._request.status

    @property
    def due_s(self) -> float:
        """When ``advance`` has something to do; infinite while nothing is under way."""
        due_s = None if self._request is None else self._request.due_s
        return math.inf if due_s is None else due_s

    def start(self, kind: RequestKind, altitude_m: float | None, now_s: float) -> None:
        """Begin a request; one still under way is dropped for it.

        Raises:
            ValueError: If a take-off comes without an altitude above zero.
        """
        plan = plan_request(kind, self._autopilot, self._telemetry, altitude_m)
        if isinstance(plan, str):
            self._request = None
            self._without_request = RequestStatus(kind, RequestState.REJECTED, plan)
            return
        self._request = Request(kind, plan, self._telemetry, now_s, self._request)
        self._heard_s, self._silent_s = now_s, -math.inf  # whoever asks has judged what is known
        self.advance(now_s)

    def advance(self, now_s: float) -> None:
        """Send what is due."""
        request = self._request
        if request is None:
            return
        self._note_silence(now_s)
        told_s = self._telemetry.heartbeat_time_s
        mode_known = told_s is None or told_s >= self._silent_s
        if (confirmation := request.advance(now_s, mode_known=mode_known)) is not None:
            self._connection.send(command_long(self._system_id, request.command, confirmation))

    def hear_ack(self, message: Any, now_s: float) -> None:
        """Take in a COMMAND_ACK of the vehicle."""
        codec = self._connection.codec
        if self._request is None or message.target_system not in (0, codec.system_id):
            return
        if message.target_component not in (0, codec.component_id):
            return
        self._request.hear_ack(message.command, message.result, now_s)
        self._request.hear_state(now_s)

    def hear_telemetry(self, events: Sequence[VehicleEvent], now_s: float) -> None:
        """Look at the state after a message of the vehicle, and at what it told."""
        self._note_silence(now_s)
        self._heard_s = max(self._heard_s, now_s)
        request = self._request
        if request is None:
            return
        for event in events:
            if event.kind is EventKind.REBOOT:
                request.abandon("the autopilot rebooted", now_s)
            elif event.severity <= Severity.WARNING:
                request.hear_text(event.text, now_s)
        request.hear_state(now_s)

    def _note_silence(self, now_s: float) -> None:
        if now_s - self._heard_s > SILENCE_S:
            self._silent_s = now_s
