"""What the link asks the vehicle for by itself, once a second: streams, origin, home, version."""

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link import messages
from companion.link.autopilots import Autopilot
from companion.link.connection import Connection
from companion.link.rates import RateMeter
from companion.link.telemetry import Telemetry
from companion.vehicle import EventKind, Severity, VehicleEvent

_PERIOD_S = 1.0
_TELL_REFUSED_S = 10.0
"""A neighbour who does not sign is told of this often."""


class Housekeeping:
    """Asks again for what is missing, and tells what could not be sent."""

    def __init__(
        self,
        connection: Connection,
        autopilot: Autopilot,
        system_id: int,
        telemetry: Telemetry,
        *,
        heard_since_s: float,
    ) -> None:
        self._connection = connection
        self._autopilot = autopilot
        self._system_id = system_id
        self._telemetry = telemetry
        self._send_errors_told = 0
        self._refused_told = 0
        self._refused_told_s = -math.inf
        self.rates = RateMeter(heard_since_s)
        self.due_s = connection.now()
        """When ``advance`` has something to do."""

    def start_over(self, now_s: float) -> None:
        """Ask anew: the autopilot has rebooted and knows nothing of us."""
        self.rates.forget_asking()
        self.due_s = now_s

    def advance(self, now_s: float) -> list[VehicleEvent]:
        """Do what is due; return what is worth telling."""
        if now_s < self.due_s:
            return []
        self.due_s = now_s + _PERIOD_S
        self._ask_for_messages(now_s)
        if self.rates.turn(now_s):
            self._ask_for_streams(now_s)
        return [
            *self._telemetry.overdue_texts(now_s),
            *self._tell_send_errors(now_s),
            *self._tell_refused(now_s),
        ]

    def _ask_for_messages(self, now_s: float) -> None:
        telemetry = self._telemetry
        missing = {
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: not telemetry.version,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: telemetry.origin is None
            or telemetry.origin_is_doubtful(now_s),
            dialect.MAVLINK_MSG_ID_HOME_POSITION: telemetry.home_altitude_m is None,
        }
        for message_id, is_missing in missing.items():
            if is_missing:
                self._connection.send(messages.request_message(self._system_id, message_id))

    def _ask_for_streams(self, now_s: float) -> None:
        wanted_hz = self._autopilot.stream_rates_hz
        for message_id, rate_hz in self.rates.too_slow(wanted_hz, now_s):
            self._connection.send(
                messages.set_message_interval(self._system_id, message_id, rate_hz)
            )

    def _tell_send_errors(self, now_s: float) -> list[VehicleEvent]:
        count = self._connection.send_errors - self._send_errors_told
        if count == 0:
            return []
        self._send_errors_told = self._connection.send_errors
        text = f"{count} packets could not be sent in the last second"
        return [VehicleEvent(now_s, EventKind.LINK_ERROR, text, Severity.WARNING)]

    def _tell_refused(self, now_s: float) -> list[VehicleEvent]:
        signing = self._connection.signing
        count = self._connection.packets_refused
        if signing is None or count == self._refused_told:
            return []
        if now_s - self._refused_told_s < _TELL_REFUSED_S:
            return []
        self._refused_told, self._refused_told_s = count, now_s
        text = f"packets dropped on the signed link so far: {signing.refused_in_words()}"
        return [VehicleEvent(now_s, EventKind.LINK_ERROR, text, Severity.WARNING)]
