"""Commands that others send to the companion, and their overheard commands to our vehicle."""

from collections import deque
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link import messages
from companion.link.codec import Received
from companion.link.connection import Connection
from companion.link.targets import geo_point
from companion.link.telemetry import Telemetry
from companion.vehicle import (
    CommandAnswer,
    CommandKind,
    EventKind,
    OperatorCommand,
    Severity,
    VehicleEvent,
    Verdict,
)

_AMSL_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
_HOME_FRAMES = (
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)

_UNSUPPORTED_MAV_FRAME = 9  # MAV_RESULT; newer than the dialect

_PAUSES = {0.0: CommandKind.PAUSE, 1.0: CommandKind.CONTINUE}
"""By param1 of DO_PAUSE_CONTINUE."""

_SAY_AGAIN_S = 1.0
"""Somebody's setpoint stream is reported this often, not by every packet."""

_COMMANDS = frozenset((dialect.MAVLINK_MSG_ID_COMMAND_INT, dialect.MAVLINK_MSG_ID_COMMAND_LONG))
_SETPOINTS = frozenset(
    (
        dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
        dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    )
)


class Inbox:
    """Answers what is addressed to us, and notices who else steers our vehicle."""

    def __init__(self, connection: Connection, vehicle_sysid: int, telemetry: Telemetry) -> None:
        self._connection = connection
        self._vehicle_sysid = vehicle_sysid
        self._telemetry = telemetry
        self._own_frames: deque[bytes] = deque(maxlen=16)
        self._said_s: dict[tuple[int, int], float] = {}
        self.judge: Callable[[OperatorCommand], CommandAnswer] | None = None
        """Decides on commands; until there is one they are answered "not now"."""

    def know_own(self, frame: bytes) -> None:
        """Remember a setpoint we sent, so that its echo is not taken for somebody else's."""
        self._own_frames.append(frame)

    def take(self, received: Received) -> list[VehicleEvent]:
        """Take in a packet of anybody; return what it means for us."""
        if received.message_id not in _COMMANDS and received.message_id not in _SETPOINTS:
            return []
        message = self._connection.codec.decode(received)
        if message is None:
            return []
        sender = (received.system_id, received.component_id)
        if received.message_id in _COMMANDS and self._is_for_us(message):
            return self._obey(message, sender, received.time_s)
        if sender == (self._vehicle_sysid, dialect.MAV_COMP_ID_AUTOPILOT1):
            return []
        if received.frame in self._own_frames or not _steers(message, self._vehicle_sysid):
            return []
        return self._report_foreign(message.get_type(), sender, received.time_s)

    def _is_for_us(self, message: Any) -> bool:
        codec = self._connection.codec
        if message.target_system != codec.system_id:
            return False
        if message.target_component == codec.component_id:
            return True
        # to all components: only a question about ourselves, the rest is the autopilot's
        return bool(message.target_component == 0) and _asks_version(message)

    def _obey(self, message: Any, sender: tuple[int, int], now_s: float) -> list[VehicleEvent]:
        name = f"{sender[0]}/{sender[1]}"
        order = read_command(message, name, home_altitude_m=self._telemetry.home_altitude_m)
        if not isinstance(order, OperatorCommand):
            self._answer(message.command, order, sender)
            if order == dialect.MAV_RESULT_ACCEPTED:
                self._connection.send(messages.own_version())
            return []
        answer = CommandAnswer(Verdict.NOT_NOW, "no flight has begun")
        if self.judge is not None:
            answer = self.judge(order)
        self._answer(message.command, answer.verdict, sender)
        text = f"{order.kind} of {name}: {answer.verdict.name.lower().replace('_', ' ')}"
        if answer.words:
            text = f"{text}: {answer.words}"
        accepted = answer.verdict is Verdict.ACCEPTED
        severity = Severity.NOTICE if accepted else Severity.WARNING
        return [VehicleEvent(now_s, EventKind.COMMAND, text, severity)]

    def _answer(self, command: int, result: int, sender: tuple[int, int]) -> None:
        self._connection.send(messages.command_ack(command, int(result), *sender))

    def _report_foreign(
        self, name: str, sender: tuple[int, int], now_s: float
    ) -> list[VehicleEvent]:
        said_s = self._said_s.get(sender)
        if said_s is not None and now_s - said_s < _SAY_AGAIN_S:
            return []
        self._said_s[sender] = now_s
        text = f"{sender[0]}/{sender[1]} sends {name} to our vehicle"
        return [VehicleEvent(now_s, EventKind.FOREIGN_SETPOINT, text, Severity.CRITICAL)]


def read_command(
    message: Any, sender: str, *, home_altitude_m: float | None
) -> OperatorCommand | int:
    """Return what a COMMAND_INT or COMMAND_LONG addressed to us orders, or its MAV_RESULT.

    Every command gets exactly one answer: what makes no sense, or is none of ours, is answered
    here; ACCEPTED here means that somebody asks for our AUTOPILOT_VERSION.

    Args:
        message: The decoded message.
        sender: Who sent it, for people.
        home_altitude_m: Above mean sea level, for altitudes given relative to home.
    """
    if message.command == dialect.MAV_CMD_DO_REPOSITION:
        return _reposition(message, sender, home_altitude_m)
    if message.command == dialect.MAV_CMD_DO_PAUSE_CONTINUE:
        kind = _PAUSES.get(message.param1)
        return int(dialect.MAV_RESULT_DENIED) if kind is None else OperatorCommand(kind, sender)
    if _asks_version(message):
        return int(dialect.MAV_RESULT_ACCEPTED)
    return int(dialect.MAV_RESULT_UNSUPPORTED)


def _asks_version(message: Any) -> bool:
    return bool(
        message.command == dialect.MAV_CMD_REQUEST_MESSAGE
        and message.param1 == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    )


def _reposition(message: Any, sender: str, home_altitude_m: float | None) -> OperatorCommand | int:
    offset_m = 0.0
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        if message.frame in _HOME_FRAMES:
            if home_altitude_m is None:
                return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
            offset_m = home_altitude_m
        elif message.frame not in _AMSL_FRAMES:
            return _UNSUPPORTED_MAV_FRAME
        position = geo_point(message.x * 1e-7, message.y * 1e-7, message.z + offset_m)
    else:
        position = geo_point(message.param5, message.param6, message.param7)
    if position is None:
        return int(dialect.MAV_RESULT_DENIED)
    return OperatorCommand(CommandKind.REPOSITION, sender, position)


def _steers(message: Any, vehicle_system_id: int) -> bool:
    """Return whether an overheard message moves our vehicle: a setpoint or a go-to."""
    if message.target_system not in (0, vehicle_system_id):
        return False
    if message.target_component not in (0, dialect.MAV_COMP_ID_AUTOPILOT1):
        return False
    if message.get_msgId() in _COMMANDS:
        return bool(message.command == dialect.MAV_CMD_DO_REPOSITION)
    return True
