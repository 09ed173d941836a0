"""A real vehicle over MAVLink: telemetry in; setpoints, requests and our heartbeat out.

Everything runs in the caller's thread, inside ``wait_until``. Nothing is sent by a timer that
lives on when the caller hangs: when the loop stops, the stream and the heartbeat stop.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion import clock
from companion.arrays import FloatArray
from companion.link import messages
from companion.link.address import parse_url
from companion.link.codec import Codec, Received
from companion.link.connection import Connection, Tap
from companion.link.discovery import Found, discover
from companion.link.inbox import Inbox
from companion.link.rates import RateMeter
from companion.link.requests import Request, plan_request
from companion.link.statustext import encode_text
from companion.link.targets import Targets
from companion.link.telemetry import Telemetry
from companion.link.transport import Peer, Transport, open_transport
from companion.vehicle import (
    EventKind,
    LinkStats,
    RequestKind,
    RequestState,
    RequestStatus,
    Severity,
    SystemStatus,
    TargetReport,
    VehicleEvent,
    VehicleInfo,
    VehicleState,
)

COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
"""191, as the companion names itself beside the vehicle's own system id."""

_AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
_PROVISIONAL_SYSTEM_ID = 1
_CHORE_PERIOD_S = 1.0
_VERSION_WAIT_S = 1.0
_MAX_EVENTS = 1000
_PARAM_RETRY_S = 0.7


def connect(
    url: str,
    *,
    vehicle_sysid: int | None = None,
    target_sysids: Sequence[int] = (),
    timeout_s: float = 30.0,
    tap: Tap | None = None,
) -> "MavlinkVehicle":
    """Open a link and find the vehicle on it.

    Args:
        url: See ``companion.link.address.parse_url``.
        vehicle_sysid: Which vehicle; ``None`` if there is but one.
        target_sysids: Systems whose positions are reported by ``targets``.
        timeout_s: How long to wait for the vehicle.
        tap: Called with ``(sent, time_s, frame)`` for every frame both ways.

    Raises:
        UsageError: If the URL or the system ids make no sense.
        LinkOpenError: If the link cannot be opened.
        LinkLostError: If the vehicle is not heard in time.
        AmbiguousVehicleError: If there are several and none was named.
        RefusedError: If the companion does not fly such a vehicle.
    """
    transport = open_transport(parse_url(url))
    try:
        return attach(
            transport,
            url=url,
            vehicle_sysid=vehicle_sysid,
            target_sysids=target_sysids,
            timeout_s=timeout_s,
            tap=tap,
        )
    except BaseException:
        transport.close()
        raise


def attach(
    transport: Transport,
    *,
    url: str,
    vehicle_sysid: int | None = None,
    target_sysids: Sequence[int] = (),
    timeout_s: float = 30.0,
    tap: Tap | None = None,
    now: Callable[[], float] = clock.now_s,
) -> "MavlinkVehicle":
    """Find the vehicle on an open transport; ``connect`` tells the rest."""
    own_system_id = _PROVISIONAL_SYSTEM_ID if vehicle_sysid is None else vehicle_sysid
    connection = Connection(transport, Codec(own_system_id, COMPONENT_ID), now, tap)
    found = discover(
        connection,
        url=url,
        vehicle_sysid=vehicle_sysid,
        target_sysids=target_sysids,
        timeout_s=timeout_s,
    )
    vehicle = MavlinkVehicle(connection, found, target_sysids)
    vehicle.wait_for_version(_VERSION_WAIT_S)
    return vehicle


class MavlinkVehicle:
    """``companion.vehicle.Vehicle`` over one connection to one autopilot."""

    def __init__(self, connection: Connection, found: Found, target_sysids: Sequence[int]) -> None:
        self._connection = connection
        self._system_id = found.system_id
        self._autopilot = found.autopilot
        connection.codec.system_id = found.system_id
        connection.reply_to(found.peer)
        self._telemetry = Telemetry(found.autopilot)
        self._targets = Targets(target_sysids)
        self._inbox = Inbox(connection, found.system_id, self._telemetry)
        self._request: Request | None = None
        self._without_request = RequestStatus()
        self._events: deque[VehicleEvent] = deque(maxlen=_MAX_EVENTS)
        started_s = found.heard[0].time_s if found.heard else connection.now()
        self._rates = RateMeter(started_s)
        self._next_chore_s = connection.now()
        self._started_s = connection.now()
        self._params: dict[str, int | float] = {}
        self._text_id = 0
        self._send_errors_said = 0
        self._packets_received = 0
        self._packets_foreign = 0
        self._setpoints_sent = 0
        self._from_autopilot: Mapping[int, Callable[[Any, float], None]] = {
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._hear_ack,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._hear_timesync,
        }
        self._from_target: Mapping[int, Callable[[Any, int, float], None]] = {
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._targets.global_position,
            dialect.MAVLINK_MSG_ID_FOLLOW_TARGET: self._targets.follow_target,
        }
        for received in found.heard:
            self._take(found.peer, received)

    # -- companion.vehicle.Vehicle ---------------------------------------------------------

    @property
    def info(self) -> VehicleInfo:
        """Who it is; ``version`` is empty until AUTOPILOT_VERSION came."""
        return VehicleInfo(
            system_id=self._system_id,
            autopilot=self._autopilot.name,
            version=self._telemetry.version,
            needs_stream_before_external=self._autopilot.needs_stream_before_external,
        )

    def now_s(self) -> float:
        """Return the time of this link's monotonic clock."""
        return self._connection.now()

    def wait_until(self, deadline_s: float) -> None:
        """Take in everything that arrives until ``deadline_s``, then return.

        Raises:
            LinkLostError: If the transport itself fails. Silence is no error: ages tell.
        """
        while True:
            next_s = self._step()
            now_s = self.now_s()
            if now_s >= deadline_s:
                return
            if self._connection.idle:
                self._connection.wait(min(deadline_s, next_s) - now_s)

    def state(self) -> VehicleState | None:
        """Return the newest snapshot; ``None`` until heartbeat, position, attitude came."""
        return self._telemetry.snapshot(self.now_s())

    def targets(self) -> Mapping[int, TargetReport]:
        """Return the newest report of every target heard, by system id."""
        return self._targets.reports()

    def take_events(self) -> Sequence[VehicleEvent]:
        """Return what happened since the last call, oldest first, and forget it."""
        events = tuple(self._events)
        self._events.clear()
        return events

    def send_velocity(self, velocity_ned_mps: FloatArray, yaw_rad: float | None = None) -> None:
        """Send exactly one velocity setpoint; it is never repeated.

        Raises:
            ValueError: If the velocity is not finite or not of shape ``(3,)``.
        """
        since_start_ms = round((self.now_s() - self._started_s) * 1e3) & 0xFFFFFFFF
        message = messages.velocity_setpoint(
            self._system_id, velocity_ned_mps, yaw_rad, time_boot_ms=since_start_ms
        )
        self._inbox.know_own(self._connection.send(message))
        self._setpoints_sent += 1

    def request(self, kind: RequestKind, *, altitude_m: float | None = None) -> None:
        """Start asking for ``kind``; retries and time-outs run inside ``wait_until``.

        Raises:
            ValueError: If a take-off comes without an altitude above zero.
        """
        plan = plan_request(kind, self._autopilot, self._telemetry, altitude_m)
        if isinstance(plan, str):
            self._request = None
            self._without_request = RequestStatus(kind, RequestState.REJECTED, plan)
            return
        self._request = Request(kind, plan, self.now_s())
        self._advance_request(self.now_s())

    def request_status(self) -> RequestStatus:
        """Return how far the newest request has come."""
        return self._without_request if self._request is None else self._request.status

    def send_heartbeat(self, status: SystemStatus) -> None:
        """Send one HEARTBEAT with our own health."""
        self._connection.send(messages.heartbeat(status))

    def say(self, text: str, severity: Severity = Severity.INFO) -> None:
        """Send a STATUSTEXT, in chunks where it is longer than 50 characters."""
        self._text_id = self._text_id % 0xFFFF + 1
        for message in encode_text(text, int(severity), self._text_id):
            self._connection.send(message)

    def stats(self) -> LinkStats:
        """Return the counts of the link."""
        return LinkStats(
            packets_received=self._packets_received,
            packets_lost=self._connection.packets_lost(self._system_id, _AUTOPILOT),
            bytes_bad=self._connection.bytes_bad,
            packets_foreign=self._packets_foreign,
            setpoints_sent=self._setpoints_sent,
            rates_hz=self._rates.rates_hz(),
        )

    def close(self) -> None:
        """Release the transport; sends nothing."""
        self._connection.close()

    # -- before flight ---------------------------------------------------------------------

    def read_param(self, name: str, timeout_s: float = 3.0) -> int | float | None:
        """Ask for a parameter and wait for it; for use before flight, since it blocks.

        Args:
            name: At most 16 ASCII characters.
            timeout_s: Firmwares answer an unknown name with silence.

        Returns:
            Its value, an ``int`` where the parameter is one; ``None`` if no answer came.
        """
        self._params.pop(name, None)
        deadline_s = self.now_s() + timeout_s
        while name not in self._params and self.now_s() < deadline_s:
            self._connection.send(messages.read_param(self._system_id, name))
            retry_s = min(_PARAM_RETRY_S, deadline_s - self.now_s())
            self._wait_for(lambda: name in self._params, retry_s)
        return self._params.get(name)

    def wait_for_version(self, timeout_s: float) -> None:
        """Wait until the firmware's version is known, but not longer than ``timeout_s``."""
        self._wait_for(lambda: bool(self._telemetry.version), timeout_s)

    def _wait_for(self, is_done: Callable[[], bool], timeout_s: float) -> None:
        deadline_s = self.now_s() + timeout_s
        while not is_done() and self.now_s() < deadline_s:
            next_s = self._step()
            if self._connection.idle:
                self._connection.wait(min(deadline_s, next_s) - self.now_s())

    # -- what comes in ---------------------------------------------------------------------

    def _step(self) -> float:
        """Take in what is there and do what is due; return when something is due next."""
        for peer, received in self._connection.receive():
            self._take(peer, received)
        now_s = self.now_s()
        if now_s >= self._next_chore_s:
            self._next_chore_s = now_s + _CHORE_PERIOD_S
            self._do_chores(now_s)
        self._advance_request(now_s)
        due_s = None if self._request is None else self._request.due_s
        return self._next_chore_s if due_s is None else min(due_s, self._next_chore_s)

    def _take(self, peer: Peer, received: Received) -> None:
        if (received.system_id, received.component_id) == (self._system_id, _AUTOPILOT):
            self._connection.reply_to(peer)
            self._packets_received += 1
            self._rates.count(received.message_id)
            self._take_from_autopilot(received)
        elif received.system_id in self._targets.system_ids:
            take_target = self._from_target.get(received.message_id)
            if take_target and (message := self._connection.codec.decode(received)):
                take_target(message, received.system_id, received.time_s)
        else:
            self._packets_foreign += 1
        self._events.extend(self._inbox.take(received))

    def _take_from_autopilot(self, received: Received) -> None:
        now_s = received.time_s
        if received.message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            self._hear_param(received)
            return
        take = self._from_autopilot.get(received.message_id)
        take_state = self._telemetry.handlers.get(received.message_id)
        if take is None and take_state is None:
            return
        message = self._connection.codec.decode(received)
        if message is None:
            return
        if take is not None:
            take(message, now_s)
        if take_state is not None:
            self._note(take_state(message, now_s), now_s)

    def _note(self, events: Sequence[VehicleEvent], now_s: float) -> None:
        self._events.extend(events)
        request = self._request
        for event in events:
            if event.kind is EventKind.REBOOT:
                self._rates.forget_asking()
                self._next_chore_s = now_s
                if request is not None:
                    request.abandon("the autopilot rebooted", now_s)
            elif request is not None and event.severity <= Severity.WARNING:
                request.hear_text(event.text, now_s)
        if request is not None:
            request.hear_state(self._telemetry.heartbeat_time_s, now_s)

    def _hear_ack(self, message: Any, now_s: float) -> None:
        codec = self._connection.codec
        if self._request is None or message.target_system not in (0, codec.system_id):
            return
        if message.target_component not in (0, codec.component_id):
            return
        self._request.hear_ack(message.command, message.result, now_s)
        self._request.hear_state(self._telemetry.heartbeat_time_s, now_s)

    def _hear_timesync(self, message: Any, now_s: float) -> None:
        if message.tc1 == 0:
            now_ns = round(self.now_s() * 1e9)
            self._connection.send(messages.timesync_reply(message.ts1, now_ns))

    def _hear_param(self, received: Received) -> None:
        message = self._connection.codec.decode(received)
        if message is not None:
            # the raw bytes: PX4 puts integers there that do not survive being a float
            raw = received.payload[:4].ljust(4, b"\0")
            value = self._autopilot.decode_param(raw, message.param_type)
            self._params[message.param_id] = value

    # -- what goes out by itself -----------------------------------------------------------

    def _advance_request(self, now_s: float) -> None:
        request = self._request
        if request is not None and (confirmation := request.advance(now_s)) is not None:
            self._connection.send(
                messages.command_long(self._system_id, request.command, confirmation)
            )

    def _do_chores(self, now_s: float) -> None:
        """Once a second: ask again for what is still missing."""
        telemetry = self._telemetry
        self._events.extend(telemetry.overdue_texts(now_s))
        missing = {
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: not telemetry.version,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: telemetry.origin is None,
            dialect.MAVLINK_MSG_ID_HOME_POSITION: telemetry.home_altitude_m is None,
        }
        for message_id, is_missing in missing.items():
            if is_missing:
                self._connection.send(messages.request_message(self._system_id, message_id))
        if self._rates.turn(now_s):
            wanted_hz = self._autopilot.stream_rates_hz
            for message_id, rate_hz in self._rates.too_slow(wanted_hz, now_s):
                self._connection.send(
                    messages.set_message_interval(self._system_id, message_id, rate_hz)
                )
        if self._connection.send_errors > self._send_errors_said:
            count = self._connection.send_errors - self._send_errors_said
            self._send_errors_said = self._connection.send_errors
            text = f"{count} packets could not be sent in the last second"
            self._events.append(VehicleEvent(now_s, EventKind.LINK_ERROR, text, Severity.WARNING))
