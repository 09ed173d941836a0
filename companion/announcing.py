"""What a run says while it flies: in the log, to ground stations, and in the recording."""

import logging
from collections.abc import Callable

from companion.guidance.limits import PREFLIGHT_TIMEOUT_S
from companion.guidance.reasons import Reason
from companion.guidance.situation import Directive, Phase
from companion.session.records import Event, Record, Source
from companion.vehicle import EventKind, Severity, Vehicle, VehicleEvent

STILL_WAITING_S = 10.0
"""What is waited for is said again this often."""
_QUIET_S = 1.0
"""Holding and going on in turns is told to ground stations no more often than this."""
_GRAVE = (Phase.STOOD_DOWN, Phase.HOLDING, Phase.HANDING_OVER)
_LOG = logging.getLogger("companion")


class Announcer:
    """Says every change of phase or reason once, with its code."""

    def __init__(
        self, vehicle: Vehicle, record: Callable[[Record], None], *, start_s: float, silent: bool
    ) -> None:
        """Announce for one run.

        Args:
            vehicle: Sends STATUSTEXT.
            record: Takes a copy.
            start_s: Zero of the recorded times.
            silent: Whether nothing may be sent (``--shadow``).
        """
        self._vehicle, self._record, self._start_s, self._silent = vehicle, record, start_s, silent
        self._line = ""
        self._waiting_since_s = self._said_s = vehicle.now_s()
        self._sent_s = float("-inf")

    def phase(self, directive: Directive, now_s: float) -> None:
        """Say in which phase the supervisor is and why, if that is new."""
        line = f"{directive.phase}: {directive.reason} [{directive.code}]"
        if line == self._line:
            self._say_again(directive, line, now_s)
            return
        self._line = line
        self._waiting_since_s = self._said_s = now_s
        severity = Severity.WARNING if directive.phase in _GRAVE else Severity.INFO
        self.log(line, severity, now_s)
        in_turns = directive.phase is Phase.HOLDING or directive.code is Reason.RESUMED
        if in_turns and now_s - self._sent_s < _QUIET_S:
            return
        self._sent_s = now_s
        self.send(line, severity)

    def events(self, events: list[VehicleEvent]) -> None:
        """Say what the vehicle, or somebody on the link, has said."""
        for event in events:
            from_autopilot = event.kind is EventKind.STATUS_TEXT
            source: Source = "autopilot" if from_autopilot else "companion"
            self.log(event.text, event.severity, event.time_s, source)
            if event.kind is EventKind.COMMAND and event.severity <= Severity.WARNING:
                self.send(event.text, event.severity)

    def log(
        self, text: str, severity: Severity, now_s: float, source: Source = "companion"
    ) -> None:
        """Write a line into the log and the recording."""
        level = logging.WARNING if severity <= Severity.WARNING else logging.INFO
        _LOG.log(level, "%s%s", "autopilot: " if source == "autopilot" else "", text)
        self._record(Event(now_s - self._start_s, severity, source, text))

    def send(self, text: str, severity: Severity) -> None:
        """Tell the ground stations."""
        if not self._silent:
            self._vehicle.say(text, severity)

    def _say_again(self, directive: Directive, line: str, now_s: float) -> None:
        """Tell whoever watches the terminal that it still waits, and for how long it will."""
        waits = directive.code is Reason.WAITING
        if not waits or now_s - self._said_s < STILL_WAITING_S:
            return
        self._said_s = now_s
        waited = f"{now_s - self._waiting_since_s:.0f} s"
        if directive.phase is Phase.PREFLIGHT:
            waited += f" of {PREFLIGHT_TIMEOUT_S:.0f} s"
        _LOG.info("%s for %s", line, waited)
