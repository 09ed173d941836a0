"""A real vehicle over MAVLink: telemetry in; setpoints, requests and our heartbeat out.

Everything runs in the caller's thread, inside ``wait_until``. Nothing is sent by a timer that
lives on when the caller hangs: when the loop stops, the stream and the heartbeat stop.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.arrays import FloatArray
from companion.computer import Computer
from companion.link import messages
from companion.link.codec import Received
from companion.link.connection import Connection
from companion.link.discovery import Found
from companion.link.housekeeping import Housekeeping
from companion.link.inbox import Inbox
from companion.link.parameters import ParameterReader
from companion.link.requests import Requests
from companion.link.route import Route
from companion.link.statustext import encode_text
from companion.link.targets import Targets
from companion.link.telemetry import Telemetry
from companion.link.transport import Peer
from companion.vehicle import (
    CommandAnswer,
    EventKind,
    LinkStats,
    OperatorCommand,
    RequestKind,
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
_MAX_EVENTS = 1000
_PARAM_RETRY_S = 0.7
_HEARTBEATS_PER_STATUS = 5


class MavlinkVehicle:
    """``companion.vehicle.Vehicle`` over one connection to one autopilot."""

    def __init__(
        self,
        connection: Connection,
        found: Found,
        target_sysids: Sequence[int],
        computer: Callable[[], Computer] | None = None,
    ) -> None:
        self._connection = connection
        self._system_id = found.system_id
        self._autopilot = found.autopilot
        connection.codec.become(found.system_id)
        self._telemetry = Telemetry(found.autopilot)
        self._targets = Targets(target_sysids)
        self._inbox = Inbox(connection, found.system_id, self._telemetry)
        self._requests = Requests(connection, found.autopilot, found.system_id, self._telemetry)
        self._parameters = ParameterReader(connection.codec, found.autopilot)
        self._events: deque[VehicleEvent] = deque(maxlen=_MAX_EVENTS)
        self._route = Route(connection, found.system_id, found.peer, self._events.append)
        self._started_s = connection.now()
        self._housekeeping = Housekeeping(
            connection,
            found.autopilot,
            found.system_id,
            self._telemetry,
            heard_since_s=found.heard[0][1].time_s if found.heard else self._started_s,
        )
        self._text_id = 0
        self._computer = computer
        self._heartbeats = 0
        self._packets_received = 0
        self._packets_foreign = 0
        self._setpoints_sent = 0
        self._from_autopilot: Mapping[int, Callable[[Any, float], None]] = {
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._requests.hear_ack,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._hear_timesync,
        }
        self._from_target: Mapping[int, Callable[[Any, int, float], None]] = {
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._targets.global_position,
            dialect.MAVLINK_MSG_ID_FOLLOW_TARGET: self._targets.follow_target,
        }
        for peer, received in found.heard:
            self._take(peer, received)

    # -- companion.vehicle.Vehicle ---------------------------------------------------------

    @property
    def info(self) -> VehicleInfo:
        """Who it is; ``version`` is empty until AUTOPILOT_VERSION came."""
        return VehicleInfo(
            system_id=self._system_id,
            autopilot=self._autopilot.name,
            version=self._telemetry.version,
            needs_stream_before_external=self._autopilot.needs_stream_before_external,
            earth_radius_m=self._autopilot.earth_radius_m,
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
            if self._connection.drained:
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
        self._requests.start(kind, altitude_m, self.now_s())

    def request_status(self) -> RequestStatus:
        """Return how far the newest request has come."""
        return self._requests.status

    def judge_commands(self, judge: Callable[[OperatorCommand], CommandAnswer]) -> None:
        """Let ``judge`` answer the commands addressed to us; until then they are put off."""
        self._inbox.judge = judge

    def send_heartbeat(self, status: SystemStatus) -> None:
        """Send one HEARTBEAT with our own health; with every fifth, this computer's."""
        self._connection.send(messages.heartbeat(status))
        self._heartbeats += 1
        if self._computer is not None and self._heartbeats % _HEARTBEATS_PER_STATUS == 0:
            since_start_ms = round((self.now_s() - self._started_s) * 1e3)
            self._connection.send(messages.computer_status(self._computer(), since_start_ms))

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
            packets_refused=self._connection.packets_refused,
            setpoints_sent=self._setpoints_sent,
            rates_hz=self._housekeeping.rates.rates_hz(),
        )

    def close(self) -> None:
        """Release the transport; sends nothing."""
        self._connection.close()

    # -- before flight ---------------------------------------------------------------------

    def read_param(self, name: str, timeout_s: float = 3.0) -> int | float | None:
        """Return one parameter, ``None`` if no answer came; as ``read_params``."""
        return self.read_params([name], timeout_s).get(name)

    def read_params(self, names: Iterable[str], timeout_s: float = 3.0) -> dict[str, int | float]:
        """Ask for parameters and wait for them; for use before flight, since it blocks.

        Args:
            names: Each of at most 16 ASCII characters.
            timeout_s: Firmwares answer an unknown name with silence.

        Returns:
            The values that came, each an ``int`` where the parameter is one.
        """
        parameters = self._parameters
        parameters.expect(names)
        deadline_s = self.now_s() + timeout_s
        while parameters.missing and self.now_s() < deadline_s:
            for name in parameters.missing:
                self._connection.send(messages.read_param(self._system_id, name))
            retry_s = min(_PARAM_RETRY_S, deadline_s - self.now_s())
            self._wait_for(lambda: not parameters.missing, retry_s)
        return dict(parameters.values)

    def global_position(self) -> TargetReport | None:
        """Return where the vehicle is on earth by its own word; ``None`` if it has not said."""
        return self._telemetry.global_position

    def request_global_position(self) -> None:
        """Ask once for GLOBAL_POSITION_INT; ArduPilot streams nothing unasked."""
        wanted = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        self._connection.send(messages.request_message(self._system_id, wanted))

    def wait_for_version(self, timeout_s: float) -> None:
        """Wait until the firmware's version is known, but not longer than ``timeout_s``."""
        self._wait_for(lambda: bool(self._telemetry.version), timeout_s)

    def _wait_for(self, is_done: Callable[[], bool], timeout_s: float) -> None:
        deadline_s = self.now_s() + timeout_s
        while not is_done() and self.now_s() < deadline_s:
            next_s = self._step()
            if self._connection.drained:
                self._connection.wait(min(deadline_s, next_s) - self.now_s())

    # -- what comes in ---------------------------------------------------------------------

    def _step(self) -> float:
        """Take in what is there and do what is due; return when something is due next."""
        packets = self._connection.receive()
        self._telemetry.punctual = self._connection.punctual
        for peer, received in packets:
            self._take(peer, received)
        now_s = self.now_s()
        self._events.extend(self._housekeeping.advance(now_s))
        self._requests.advance(now_s)
        return min(self._requests.due_s, self._housekeeping.due_s)

    def _take(self, peer: Peer, received: Received) -> None:
        if self._route.carries(peer, received):
            self._packets_received += 1
            self._housekeeping.rates.count(received.message_id)
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
            self._parameters.hear(received)
            return
        take = self._from_autopilot.get(received.message_id)
        take_state = None
        if self._telemetry.wants(received.message_id, now_s):
            take_state = self._telemetry.handlers[received.message_id]
        if take is None and take_state is None:
            return
        message = self._connection.codec.decode(received)
        if message is None:
            return
        if take is not None:
            take(message, now_s)
        if take_state is not None:
            events = take_state(message, now_s)
            self._events.extend(events)
            self._requests.hear_telemetry(events, now_s)
            if any(event.kind is EventKind.REBOOT for event in events):
                self._housekeeping.start_over(now_s)

    def _hear_timesync(self, message: Any, now_s: float) -> None:
        if message.tc1 == 0:
            now_ns = round(self.now_s() * 1e9)
            self._connection.send(messages.timesync_reply(message.ts1, now_ns))
