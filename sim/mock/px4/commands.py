"""Commands of the PX4 personality and their COMMAND_ACK results.

``run_command`` decides; sending the answer, and reading the addresses, is the link's business.
Results and texts are those measured on PX4 1.18 (``Commander.cpp``).
"""

import math
from dataclasses import replace

from companion.world.frames import GeoPoint
from sim.mock.autopilot import CRITICAL, INFO
from sim.mock.commands import (
    FORCE,
    REPOSITION_CHANGE_MODE,
    Command,
    CommandHandler,
    CommandId,
    Result,
    whole,
)
from sim.mock.px4.commander import Px4
from sim.mock.px4.modes import MODE_CUSTOM, Mode, find_base_mode, find_mode, knows_main_mode

UNIT_GPS, FAILURE_OK, FAILURE_OFF = 4, 0, 1
"""FAILURE_UNIT and FAILURE_TYPE of INJECT_FAILURE."""
COMP_ID_MISSIONPLANNER = 190
"""The component id of ground stations; only they are told why a mode is refused."""


def run_command(px4: Px4, command: Command) -> Result:
    """Carry out a command of the flight stack; a command of the link is not known here."""
    handler = _HANDLERS.get(command.command)
    return Result.UNSUPPORTED if handler is None else handler(px4, command)


def set_mode(px4: Px4, base_mode: int, main: int, sub: int, source_component: int) -> Result:
    """Handle DO_SET_MODE and SET_MODE."""
    mode = find_mode(main, sub) if base_mode & MODE_CUSTOM else find_base_mode(base_mode)
    if mode is None:
        known = "auto" if knows_main_mode(main) else "main"
        kind = known if base_mode & MODE_CUSTOM else "base"
        px4.say(CRITICAL, f"Unsupported {kind} mode")
        return Result.TEMPORARILY_REJECTED
    explain = source_component == COMP_ID_MISSIONPLANNER
    return _accepted(px4.request_mode(mode, explain=explain))


def _accepted(done: bool) -> Result:
    return Result.ACCEPTED if done else Result.TEMPORARILY_REJECTED


def _do_set_mode(px4: Px4, command: Command) -> Result:
    base_mode, main, sub = (whole(value) for value in command.params[:3])
    return set_mode(px4, base_mode, main, sub, command.source_component)


def _arm_disarm(px4: Px4, command: Command) -> Result:
    wanted, magic = command.params[0], command.params[1]
    if not -0.5 < wanted < 1.5:
        px4.say(CRITICAL, f"Unsupported ARM_DISARM param: {wanted:.3f}")
        return Result.UNSUPPORTED
    if wanted >= 0.5:
        return _accepted(px4.arm())
    return _accepted(px4.disarm(forced=magic == FORCE))


def _takeoff(px4: Px4, command: Command) -> Result:
    done = px4.take_off(command.params[6])
    return _accepted(done)


def _land(px4: Px4, command: Command) -> Result:
    px4.request_mode(Mode.LAND)
    px4.say(INFO, "Landing at current position")
    return Result.ACCEPTED


def _return(px4: Px4, command: Command) -> Result:
    done = px4.request_mode(Mode.RTL, explain=True)
    if done:
        px4.say(INFO, "Returning to launch")
    return _accepted(done)


def _reposition(px4: Px4, command: Command) -> Result:
    if not whole(command.params[1]) & REPOSITION_CHANGE_MODE and px4.mode is not Mode.LOITER:
        return Result.DENIED
    here = px4.estimator.geodetic(px4.body.position_m)
    latitude, longitude, altitude = command.params[4:]
    point: GeoPoint = here
    if math.isfinite(latitude) and math.isfinite(longitude):
        point = replace(point, latitude_deg=latitude, longitude_deg=longitude)
    if math.isfinite(altitude):
        point = replace(point, altitude_m=altitude)
    return _accepted(px4.reposition(point))


def _reboot(px4: Px4, command: Command) -> Result:
    """PREFLIGHT_REBOOT_SHUTDOWN: 0 asks for nothing, and PX4 SITL refuses all else."""
    return Result.ACCEPTED if whole(command.params[0]) == 0 else Result.DENIED


def _set_home(px4: Px4, command: Command) -> Result:
    latitude, longitude, altitude = command.params[4:]
    if command.params[0] > 0.5:
        return _accepted(px4.set_home(None))
    if not all(map(math.isfinite, (latitude, longitude, altitude))):
        return Result.DENIED
    return _accepted(px4.set_home(GeoPoint(latitude, longitude, altitude)))


def _start_mission(px4: Px4, command: Command) -> Result:
    px4.say(CRITICAL, "Mission start denied! No valid mission")
    return Result.DENIED


def _check(px4: Px4, command: Command) -> Result:
    return Result.ACCEPTED


def _terminate(px4: Px4, command: Command) -> Result:
    """DO_FLIGHTTERMINATION: refused on the ground, and not imitated in the air."""
    asked = command.params[0] > 0.5 and px4.armed
    return Result.UNSUPPORTED if asked else Result.DENIED


def _inject_failure(px4: Px4, command: Command) -> Result:
    """INJECT_FAILURE: of the simulator's failures, GPS off and well again."""
    unit, failure = whole(command.params[0]), whole(command.params[1])
    if unit != UNIT_GPS or failure not in (FAILURE_OK, FAILURE_OFF):
        return Result.UNSUPPORTED
    px4.lose_gps(lost=failure == FAILURE_OFF)
    return Result.ACCEPTED


_HANDLERS: dict[int, CommandHandler] = {
    CommandId.NAV_RETURN_TO_LAUNCH: _return,
    CommandId.NAV_LAND: _land,
    CommandId.NAV_TAKEOFF: _takeoff,
    CommandId.DO_SET_MODE: _do_set_mode,
    CommandId.DO_REPOSITION: _reposition,
    CommandId.DO_SET_HOME: _set_home,
    CommandId.DO_FLIGHTTERMINATION: _terminate,
    CommandId.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    CommandId.MISSION_START: _start_mission,
    CommandId.RUN_PREARM_CHECKS: _check,
    CommandId.INJECT_FAILURE: _inject_failure,
    CommandId.COMPONENT_ARM_DISARM: _arm_disarm,
}
