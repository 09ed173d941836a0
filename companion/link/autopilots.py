"""What differs between PX4 and ArduPilot, as answers to questions.

Nothing else in the companion asks which firmware flies. The facts are from the firmwares' code and
from measurements on ArduCopter 4.6.3 and PX4 1.18 in their simulators.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import RefusedError
from companion.vehicle import FlightMode, LandedState, SystemStatus

_LEAVING_GROUND = (LandedState.TAKING_OFF, LandedState.IN_AIR)


@dataclass(frozen=True, slots=True)
class Command:
    """A MAVLink command: MAV_CMD and the seven parameters of COMMAND_LONG."""

    number: int
    params: tuple[float, float, float, float, float, float, float]


class Autopilot(Protocol):
    """Questions whose answers depend on the firmware."""

    name: str
    needs_stream_before_external: bool
    """Whether setpoints must flow before external mode is asked for; else they must not."""
    earth_radius_m: float
    """Radius of the sphere on which it turns latitude and longitude into its local frame."""
    stream_rates_hz: Mapping[int, float]
    """Messages the companion lives on, by id, each with the rate it wants."""
    estimator_message_id: int
    """The message whose ``flags`` tell the estimator's health."""

    def mode(self, custom_mode: int) -> FlightMode:
        """Return the mode a HEARTBEAT shows."""
        ...

    def mode_name(self, custom_mode: int) -> str:
        """Return the firmware's own word for the mode of a HEARTBEAT."""
        ...

    def set_mode(self, mode: FlightMode) -> Command:
        """Return the command that asks for ``mode``."""
        ...

    def take_off(self, altitude_m: float, ground_amsl_m: float | None) -> Command | None:
        """Return the take-off to ``altitude_m`` above the ground the vehicle stands on.

        ``None`` if the firmware wants an altitude above mean sea level and none is known.
        """
        ...

    def takes_off(self, mode: FlightMode, landed: LandedState) -> bool:
        """Return whether the vehicle's state shows the take-off under way."""
        ...

    def ready_to_arm(self, status: SystemStatus, prearm_ok: bool | None) -> bool:
        """Return whether arming would be accepted, ``prearm_ok`` being of SYS_STATUS."""
        ...

    def position_valid(self, flags: int, landed: LandedState) -> bool:
        """Return whether the estimator vouches for position and velocity."""
        ...

    def decode_param(self, raw: bytes, param_type: int) -> int | float:
        """Return a parameter's value from the four bytes of PARAM_VALUE's value field."""
        ...


def autopilot_of(autopilot: int, vehicle_type: int) -> Autopilot:
    """Return the answers for what a HEARTBEAT says of itself.

    Args:
        autopilot: MAV_AUTOPILOT.
        vehicle_type: MAV_TYPE. Only copters: modes have other numbers on ArduPilot's planes,
            and a velocity setpoint means something else to wings.

    Raises:
        RefusedError: If the companion does not know how to fly it.
    """
    firmwares: Mapping[int, type[Px4] | type[ArduPilot]] = {
        dialect.MAV_AUTOPILOT_PX4: Px4,
        dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduPilot,
    }
    firmware = firmwares.get(autopilot)
    if firmware is None:
        raise RefusedError(
            f"the vehicle's firmware is MAV_AUTOPILOT {autopilot}; only PX4 "
            f"({dialect.MAV_AUTOPILOT_PX4}) and ArduPilot "
            f"({dialect.MAV_AUTOPILOT_ARDUPILOTMEGA}) are flown"
        )
    if vehicle_type not in _COPTER_TYPES:
        raise RefusedError(
            f"the vehicle is of MAV_TYPE {vehicle_type}; only multicopters and helicopters "
            "are flown"
        )
    return firmware()


_COPTER_TYPES = frozenset(
    (
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_TYPE_COAXIAL,
        dialect.MAV_TYPE_HELICOPTER,
        dialect.MAV_TYPE_HEXAROTOR,
        dialect.MAV_TYPE_OCTOROTOR,
        dialect.MAV_TYPE_TRICOPTER,
        dialect.MAV_TYPE_DODECAROTOR,
        dialect.MAV_TYPE_DECAROTOR,
    )
)

_ATTITUDE_OK = 1
_VELOCITY_OK = 2 | 4
_POSITION_OK = 8 | 16
"""Horizontal position, relative or absolute: either will do."""
_ALTITUDE_OK = 32
_CONST_POSITION = 128


def _estimator_ok(flags: int, faults: int) -> bool:
    """Judge ESTIMATOR_STATUS_FLAGS or EKF_STATUS_FLAGS, alike in their low bits."""
    needed = _ATTITUDE_OK | _VELOCITY_OK | _ALTITUDE_OK
    return flags & needed == needed and bool(flags & _POSITION_OK) and not flags & faults


class Px4:
    """PX4, measured on 1.18."""

    name = "px4"
    needs_stream_before_external = True
    earth_radius_m = 6_371_000.0  # CONSTANTS_RADIUS_OF_EARTH
    estimator_message_id = dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS
    stream_rates_hz: Mapping[int, float] = {
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,  # to check the local one by
        dialect.MAVLINK_MSG_ID_ATTITUDE: 10.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_ODOMETRY: 1.0,  # only for its reset_counter
    }

    _AUTO = 4
    _OFFBOARD = 6
    _MAIN_NAMES: Mapping[int, str] = {
        1: "MANUAL",
        2: "ALTCTL",
        3: "POSCTL",
        4: "AUTO",
        5: "ACRO",
        6: "OFFBOARD",
        7: "STABILIZED",
        8: "RATTITUDE",
        10: "TERMINATION",
    }
    _AUTO_NAMES: Mapping[int, str] = {
        1: "READY",
        2: "TAKEOFF",
        3: "LOITER",
        4: "MISSION",
        5: "RTL",
        6: "LAND",
        8: "FOLLOW",
        9: "PRECLAND",
        10: "VTOL_TAKEOFF",
    }
    _AUTO_MODES: Mapping[int, FlightMode] = {
        2: FlightMode.TAKEOFF,
        3: FlightMode.HOLD,
        5: FlightMode.RETURN,
        6: FlightMode.LAND,
        9: FlightMode.LAND,
        10: FlightMode.TAKEOFF,
    }
    _MODE_NUMBERS: Mapping[FlightMode, tuple[int, int]] = {
        FlightMode.EXTERNAL: (_OFFBOARD, 0),
        FlightMode.HOLD: (_AUTO, 3),
        FlightMode.LAND: (_AUTO, 6),
        FlightMode.RETURN: (_AUTO, 5),
    }

    def mode(self, custom_mode: int) -> FlightMode:
        """Return the mode of ``main << 16 | sub << 24``."""
        main, sub = _px4_mode(custom_mode)
        if main == self._OFFBOARD:
            return FlightMode.EXTERNAL
        if main == self._AUTO:
            return self._AUTO_MODES.get(sub, FlightMode.OTHER)
        return FlightMode.OTHER

    def mode_name(self, custom_mode: int) -> str:
        """Return the name as PX4 writes it, ``AUTO.LOITER``."""
        main, sub = _px4_mode(custom_mode)
        name = self._MAIN_NAMES.get(main, f"MODE {main}.{sub}")
        if main == self._AUTO:
            return f"{name}.{self._AUTO_NAMES.get(sub, str(sub))}"
        return name

    def set_mode(self, mode: FlightMode) -> Command:
        """Return DO_SET_MODE with main and sub mode apart."""
        main, sub = self._MODE_NUMBERS[mode]
        return _set_mode(main, sub)

    def take_off(self, altitude_m: float, ground_amsl_m: float | None) -> Command | None:
        """Return NAV_TAKEOFF; PX4's altitude is above mean sea level, the place is here."""
        if ground_amsl_m is None:
            return None
        here = math.nan
        params = (0.0, 0.0, 0.0, here, here, here, ground_amsl_m + altitude_m)
        return Command(dialect.MAV_CMD_NAV_TAKEOFF, params)

    def takes_off(self, mode: FlightMode, landed: LandedState) -> bool:
        """PX4 has a mode for it, entered even while disarmed."""
        return mode is FlightMode.TAKEOFF or landed in _LEAVING_GROUND

    def ready_to_arm(self, status: SystemStatus, prearm_ok: bool | None) -> bool:
        """PX4 stays at MAV_STATE_UNINIT while the present mode could not be flown."""
        return status >= SystemStatus.STANDBY and prearm_ok is not False

    def position_valid(self, flags: int, landed: LandedState) -> bool:
        """LOCAL_POSITION_NED goes on when GPS is lost; the flags fall.

        CONST_POS_MODE is set while standing on the ground and a fault in the air.
        """
        faults = dialect.ESTIMATOR_GPS_GLITCH | dialect.ESTIMATOR_ACCEL_ERROR
        if landed is LandedState.IN_AIR:
            faults |= _CONST_POSITION
        return _estimator_ok(flags, faults)

    def decode_param(self, raw: bytes, param_type: int) -> int | float:
        """PX4 puts the bytes of an integer into the float field (PARAM_ENCODE_BYTEWISE)."""
        layout = _BYTEWISE.get(param_type, "<f")
        value: int | float = struct.unpack_from(layout, raw)[0]
        return value


class ArduPilot:
    """ArduCopter, measured on 4.6.3."""

    name = "ardupilot"
    needs_stream_before_external = False
    earth_radius_m = 6_378_100.0  # LOCATION_SCALING_FACTOR: 0.0111318845 m in 1e-7 degrees
    estimator_message_id = dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT
    stream_rates_hz: Mapping[int, float] = {
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,  # to check the local one by
        dialect.MAVLINK_MSG_ID_ATTITUDE: 10.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    }

    _MODES: Mapping[int, tuple[str, FlightMode]] = {
        0: ("STABILIZE", FlightMode.OTHER),
        1: ("ACRO", FlightMode.OTHER),
        2: ("ALT_HOLD", FlightMode.OTHER),
        3: ("AUTO", FlightMode.OTHER),
        4: ("GUIDED", FlightMode.EXTERNAL),
        5: ("LOITER", FlightMode.HOLD),
        6: ("RTL", FlightMode.RETURN),
        7: ("CIRCLE", FlightMode.OTHER),
        9: ("LAND", FlightMode.LAND),
        11: ("DRIFT", FlightMode.OTHER),
        13: ("SPORT", FlightMode.OTHER),
        14: ("FLIP", FlightMode.OTHER),
        15: ("AUTOTUNE", FlightMode.OTHER),
        16: ("POSHOLD", FlightMode.OTHER),
        17: ("BRAKE", FlightMode.HOLD),
        18: ("THROW", FlightMode.OTHER),
        19: ("AVOID_ADSB", FlightMode.OTHER),
        20: ("GUIDED_NOGPS", FlightMode.OTHER),
        21: ("SMART_RTL", FlightMode.RETURN),
        22: ("FLOWHOLD", FlightMode.OTHER),
        23: ("FOLLOW", FlightMode.OTHER),
        24: ("ZIGZAG", FlightMode.OTHER),
        25: ("SYSTEMID", FlightMode.OTHER),
        26: ("AUTOROTATE", FlightMode.OTHER),
        27: ("AUTO_RTL", FlightMode.RETURN),
    }
    _MODE_NUMBERS: Mapping[FlightMode, int] = {
        FlightMode.EXTERNAL: 4,
        FlightMode.HOLD: 17,  # BRAKE: LOITER would read the pilot's throttle
        FlightMode.LAND: 9,
        FlightMode.RETURN: 6,
    }

    def mode(self, custom_mode: int) -> FlightMode:
        """Return the mode of a Copter mode number."""
        return self._MODES.get(custom_mode, ("", FlightMode.OTHER))[1]

    def mode_name(self, custom_mode: int) -> str:
        """Return the name as ArduPilot writes it, ``GUIDED``."""
        return self._MODES.get(custom_mode, (f"MODE {custom_mode}", FlightMode.OTHER))[0]

    def set_mode(self, mode: FlightMode) -> Command:
        """Return DO_SET_MODE with the Copter mode number."""
        return _set_mode(self._MODE_NUMBERS[mode], 0)

    def take_off(self, altitude_m: float, ground_amsl_m: float | None) -> Command | None:
        """Return NAV_TAKEOFF; ArduPilot's altitude is above home, which arming sets here."""
        return Command(dialect.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude_m))

    def takes_off(self, mode: FlightMode, landed: LandedState) -> bool:
        """ArduPilot climbs inside GUIDED; only the landed state tells."""
        return landed in _LEAVING_GROUND

    def ready_to_arm(self, status: SystemStatus, prearm_ok: bool | None) -> bool:
        """MAV_STATE is STANDBY long before the checks pass; only PREARM_CHECK tells."""
        return status >= SystemStatus.STANDBY and prearm_ok is True

    def position_valid(self, flags: int, landed: LandedState) -> bool:
        """0x33f when ready, 0x025 seven seconds after GPS is lost."""
        faults = dialect.EKF_GPS_GLITCHING | dialect.EKF_UNINITIALIZED | _CONST_POSITION
        return _estimator_ok(flags, faults)

    def decode_param(self, raw: bytes, param_type: int) -> int | float:
        """ArduPilot casts integers to float (PARAM_ENCODE_C_CAST)."""
        value: float = struct.unpack_from("<f", raw)[0]
        return int(value) if param_type in _BYTEWISE and math.isfinite(value) else value


_BYTEWISE = {
    dialect.MAV_PARAM_TYPE_UINT8: "<B",
    dialect.MAV_PARAM_TYPE_INT8: "<b",
    dialect.MAV_PARAM_TYPE_UINT16: "<H",
    dialect.MAV_PARAM_TYPE_INT16: "<h",
    dialect.MAV_PARAM_TYPE_UINT32: "<I",
    dialect.MAV_PARAM_TYPE_INT32: "<i",
}


def _px4_mode(custom_mode: int) -> tuple[int, int]:
    return custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF


def _set_mode(main: int, sub: int) -> Command:
    flags = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    return Command(dialect.MAV_CMD_DO_SET_MODE, (flags, main, sub, 0.0, 0.0, 0.0, 0.0))
