"""Commands as both autopilots take them: their numbers, their results, their fields."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

FORCE = 21196
"""The magic number in param2 of COMPONENT_ARM_DISARM that disarms in the air."""
REPOSITION_CHANGE_MODE = 1
NOT_GIVEN = 2**31 - 1
"""INT32_MAX in x or y says "not given", as NaN does in COMMAND_LONG."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class CommandId(IntEnum):
    """MAV_CMD as far as they are known here."""

    NAV_LOITER_UNLIM = 17
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    DO_SET_MODE = 176
    DO_SET_HOME = 179
    DO_FLIGHTTERMINATION = 185
    DO_REPOSITION = 192
    PREFLIGHT_REBOOT_SHUTDOWN = 246
    MISSION_START = 300
    COMPONENT_ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    GET_HOME_POSITION = 410
    INJECT_FAILURE = 420
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_AUTOPILOT_CAPABILITIES = 520


_DEGREES_E7 = (CommandId.DO_REPOSITION, CommandId.DO_SET_HOME, CommandId.NAV_TAKEOFF)

CommandHandler = Callable[[Any, "Command"], Result]
"""What an autopilot makes of a command."""


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG or COMMAND_INT with latitude and longitude already in degrees."""

    command: int
    params: tuple[float, float, float, float, float, float, float]
    source_component: int
    frame: int | None
    """MAV_FRAME of COMMAND_INT; ``None`` for COMMAND_LONG, which has none."""


def read_command(message: Any) -> Command:
    """Read COMMAND_LONG or COMMAND_INT."""
    sender, number = message.get_srcComponent(), message.command
    if message.get_type() == "COMMAND_LONG":
        one, two, three, four, x, y, z = (getattr(message, f"param{n}") for n in range(1, 8))
        return Command(number, (one, two, three, four, x, y, z), sender, None)
    x, y = float(message.x), float(message.y)
    if number in _DEGREES_E7:
        x, y = (value / 1e7 if value != NOT_GIVEN else math.nan for value in (x, y))
    params = (message.param1, message.param2, message.param3, message.param4, x, y, message.z)
    return Command(number, params, sender, message.frame)


def whole(value: float) -> int:
    """Return a float field that holds a whole number; -1 for NaN and infinities."""
    return int(value) if math.isfinite(value) else -1
