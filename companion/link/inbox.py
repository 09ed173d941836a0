"""Commands that others send to the companion, and their overheard commands to our vehicle."""

from collections import deque
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link import messages
from companion.link.codec import Received
from companion.link.connection import Connection
from companion.link.targets import geo_point
from companion.link.telemetry import Telemetry
from companion.vehicle import EventKind, Severity, TargetReport, VehicleEvent
from companion.world.frames import GeoPoint

_AMSL_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
_HOME_FRAMES = (
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)

_UNSUPPORTED_MAV_FRAME = 9  # MAV_RESULT; newer than the dialect

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
        answer = answer_command(
            message, sender[0], home_altitude_m=self._telemetry.home_altitude_m, now_s=now_s
        )
        self._connection.send(messages.command_ack(message.command, answer.result, *sender))
        if answer.sends_version:
            self._connection.send(messages.own_version())
        if answer.target is None:
            return []
        text = f"new target by DO_REPOSITION of {sender[0]}/{sender[1]}"
        return [VehicleEvent(now_s, EventKind.REPOSITION, text, target=answer.target)]

    def _report_foreign(
        self, name: str, sender: tuple[int, int], now_s: float
    ) -> list[VehicleEvent]:
        said_s = self._said_s.get(sender)
        if said_s is not None and now_s - said_s < _SAY_AGAIN_S:
            return []
        self._said_s[sender] = now_s
        text = f"{sender[0]}/{sender[1]} sends {name} to our vehicle"
        return [VehicleEvent(now_s, EventKind.FOREIGN_SETPOINT, text, Severity.CRITICAL)]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a command addressed to us comes to."""

    result: int
    """MAV_RESULT for the COMMAND_ACK."""
    target: TargetReport | None = None
    """Where DO_REPOSITION points."""
    sends_version: bool = False
    """Whether our AUTOPILOT_VERSION is asked for."""


def answer_command(
    message: Any, system_id: int, *, home_altitude_m: float | None, now_s: float
) -> Answer:
    """Judge a COMMAND_INT or COMMAND_LONG addressed to us; every one gets an answer.

    Args:
        message: The decoded message.
        system_id: Who sent it.
        home_altitude_m: Above mean sea level, for altitudes given relative to home.
        now_s: Its arrival.
    """
    if message.command == dialect.MAV_CMD_DO_REPOSITION:
        return _reposition(message, system_id, home_altitude_m, now_s)
    if _asks_version(message):
        return Answer(dialect.MAV_RESULT_ACCEPTED, sends_version=True)
    return Answer(dialect.MAV_RESULT_UNSUPPORTED)


def _asks_version(message: Any) -> bool:
    return bool(
        message.command == dialect.MAV_CMD_REQUEST_MESSAGE
        and message.param1 == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    )


def _reposition(
    message: Any, system_id: int, home_altitude_m: float | None, now_s: float
) -> Answer:
    offset_m = 0.0
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        if message.frame in _HOME_FRAMES:
            if home_altitude_m is None:
                return Answer(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
            offset_m = home_altitude_m
        elif message.frame not in _AMSL_FRAMES:
            return Answer(_UNSUPPORTED_MAV_FRAME)
        position = geo_point(message.x * 1e-7, message.y * 1e-7, message.z + offset_m)
    else:
        position = geo_point(message.param5, message.param6, message.param7)
    if position is None:
        return Answer(dialect.MAV_RESULT_DENIED)
    return Answer(dialect.MAV_RESULT_ACCEPTED, _target(system_id, position, now_s))


def _target(system_id: int, position: GeoPoint, now_s: float) -> TargetReport:
    return TargetReport(
        time_s=now_s, system_id=system_id, source="DO_REPOSITION", position=position
    )


def _steers(message: Any, vehicle_system_id: int) -> bool:
    """Return whether an overheard message moves our vehicle: a setpoint or a go-to."""
    if message.target_system not in (0, vehicle_system_id):
        return False
    if message.target_component not in (0, dialect.MAV_COMP_ID_AUTOPILOT1):
        return False
    if message.get_msgId() in _COMMANDS:
        return bool(message.command == dialect.MAV_CMD_DO_REPOSITION)
    return True
