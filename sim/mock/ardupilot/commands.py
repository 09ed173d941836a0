"""Commands of ArduCopter and their COMMAND_ACK results, as measured on 4.6.3."""

import math
from dataclasses import replace

from companion.world.frames import GeoPoint
from sim.mock.ardupilot.copter import ArduCopter
from sim.mock.ardupilot.modes import MODE_CUSTOM, Mode
from sim.mock.commands import (
    FORCE,
    REPOSITION_CHANGE_MODE,
    Command,
    CommandHandler,
    CommandId,
    Result,
    whole,
)

FORCE_ARM = 2989
GLOBAL, GLOBAL_RELATIVE_ALT = 0, 3
RELATIVE_FRAMES = (GLOBAL_RELATIVE_ALT, 6)
AMSL_FRAMES = (GLOBAL, 5)


def run_command(copter: ArduCopter, command: Command) -> Result:
    """Carry out a command of the flight stack; a command of the link is not known here."""
    handler = _HANDLERS.get(command.command)
    return Result.UNSUPPORTED if handler is None else handler(copter, command)


def set_mode(copter: ArduCopter, base_mode: int, number: int) -> Result:
    """Handle DO_SET_MODE and SET_MODE (A11): FAILED, where PX4 says TEMPORARILY_REJECTED."""
    if not base_mode & MODE_CUSTOM:
        return Result.DENIED
    return _done(copter.request_mode(number))


def _done(done: bool) -> Result:
    return Result.ACCEPTED if done else Result.FAILED


def _do_set_mode(copter: ArduCopter, command: Command) -> Result:
    return set_mode(copter, whole(command.params[0]), whole(command.params[1]))


def _arm_disarm(copter: ArduCopter, command: Command) -> Result:
    wanted, magic = command.params[0], command.params[1]
    if wanted == 1.0:
        return _done(copter.arm(forced=magic == FORCE_ARM))
    if wanted == 0.0:
        return _done(copter.disarm(forced=magic == FORCE))
    return Result.UNSUPPORTED


def _reboot(copter: ArduCopter, command: Command) -> Result:
    """PREFLIGHT_REBOOT_SHUTDOWN: 1 restarts it, 3 would hold it in its loader."""
    if copter.armed:
        return Result.FAILED
    if command.params[0] != 1.0:
        return Result.UNSUPPORTED
    copter.wants_reboot = True
    return Result.ACCEPTED


def _takeoff(copter: ArduCopter, command: Command) -> Result:
    if command.frame not in (None, GLOBAL_RELATIVE_ALT):
        return Result.DENIED
    return _done(copter.take_off(command.params[6]))


def _change_to(mode: Mode) -> CommandHandler:
    def change(copter: ArduCopter, command: Command) -> Result:
        return _done(copter.request_mode(mode.value))

    return change


def _reposition(copter: ArduCopter, command: Command) -> Result:
    changes = whole(command.params[1]) & REPOSITION_CHANGE_MODE
    if copter.mode is not Mode.GUIDED and not changes:
        return Result.DENIED
    latitude, longitude, altitude = command.params[4:]
    frame = GLOBAL_RELATIVE_ALT if command.frame is None else command.frame
    on_earth = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and (latitude or longitude)
    if not (on_earth and math.isfinite(altitude) and frame in (*RELATIVE_FRAMES, *AMSL_FRAMES)):
        return Result.DENIED
    point = GeoPoint(latitude, longitude, altitude)
    if frame in RELATIVE_FRAMES:
        if copter.home_true_m is None:
            return Result.DENIED
        home = copter.estimator.geodetic(copter.home_true_m)
        point = replace(point, altitude_m=home.altitude_m + altitude)
    return _done(copter.reposition(point))


_HANDLERS: dict[int, CommandHandler] = {
    CommandId.NAV_LOITER_UNLIM: _change_to(Mode.LOITER),
    CommandId.NAV_RETURN_TO_LAUNCH: _change_to(Mode.RTL),
    CommandId.NAV_LAND: _change_to(Mode.LAND),
    CommandId.NAV_TAKEOFF: _takeoff,
    CommandId.DO_SET_MODE: _do_set_mode,
    CommandId.DO_REPOSITION: _reposition,
    CommandId.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    CommandId.COMPONENT_ARM_DISARM: _arm_disarm,
}
